// The viewer of exported web pages: orbit, sliders for expressions and joints, clips. Bundled by tools/web_bundle.sh.
//
// Every frame starts from what the clip says, or from rest; the sliders' turns and weights come on top.
import {
  Box3, Color, Euler, GridHelper, PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer,
} from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const JOINTS = [
  "head", "neck", "jaw", "left_eye", "right_eye", "spine1", "spine2", "spine3", "left_shoulder", "left_elbow", "left_wrist",
  "right_shoulder", "right_elbow", "right_wrist", "left_hip", "left_knee", "left_ankle", "right_hip", "right_knee", "right_ankle",
];
const $ = (id) => document.getElementById(id);

function bytes(base64) {
  return Uint8Array.from(atob(base64.trim()), (letter) => letter.charCodeAt(0)).buffer;
}

function element(kind, properties, ...children) {
  const made = Object.assign(document.createElement(kind), properties);
  made.append(...children);
  return made;
}

function slider(label, name, low, high, step, changed) {
  const input = element("input", { type: "range", min: low, max: high, step, value: 0, name, ariaLabel: name });
  const shown = element("output", { textContent: "0" });
  input.oninput = () => {
    shown.textContent = input.value;
    changed(Number(input.value));
  };
  return element("label", { className: "slider" }, element("span", { textContent: label }), input, shown);
}

class Viewer {
  constructor(gltf) {
    this.gltf = gltf;
    this.mesh = null;
    this.joints = {};
    gltf.scene.traverse((node) => {
      if (node.isSkinnedMesh) this.mesh = node;
      if (node.isBone) this.joints[node.name] = node;
    });
    this.mesh.frustumCulled = false; // its box is that of the rest pose
    this.rest = Object.values(this.joints).map((joint) => [joint, joint.quaternion.clone(), joint.position.clone()]);
    this.turns = {};
    this.weights = new Float32Array(this.mesh.morphTargetInfluences.length);
    this.clip = null;
    this.time = 0;
    this.playing = true;
    this.scene();
    this.expressionSliders();
    this.jointSliders();
    this.clipList();
  }

  scene() {
    this.renderer = new WebGLRenderer({ canvas: $("view"), antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.stage = new Scene();
    this.stage.background = new Color(0x2b2f36);
    this.stage.add(this.gltf.scene, new GridHelper(4, 16, 0x59606b, 0x3b4149));
    const box = new Box3().setFromObject(this.mesh);
    const middle = box.getCenter(new Vector3());
    this.height = box.getSize(new Vector3()).y;
    this.camera = new PerspectiveCamera(32, 1, 0.05, 50);
    this.camera.position.set(0, middle.y, 2.3 * this.height);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.copy(middle);
    this.controls.update();
    this.home = [this.camera.position.clone(), middle.clone()];
    const fit = () => {
      const { clientWidth, clientHeight } = $("stage");
      this.renderer.setSize(clientWidth, clientHeight, false);
      this.camera.aspect = clientWidth / clientHeight;
      this.camera.updateProjectionMatrix();
    };
    addEventListener("resize", fit);
    fit();
    $("whole").onclick = () => this.look(...this.home);
    $("face").onclick = () => {
      const head = this.joints.head.getWorldPosition(new Vector3()).add(new Vector3(0, 0.06, 0));
      this.look(head.clone().add(new Vector3(0, 0, 0.42 * this.height)), head);
    };
    let last = 0;
    this.renderer.setAnimationLoop((now) => {
      this.frame(Math.min((now - last) / 1000, 0.1));
      last = now;
    });
  }

  look(from, at) {
    this.camera.position.copy(from);
    this.controls.target.copy(at);
    this.controls.update();
  }

  expressionSliders() {
    const names = Object.entries(this.mesh.morphTargetDictionary).sort((a, b) => a[1] - b[1]);
    for (const [name, index] of names) {
      $("expressions").append(slider(name, name, 0, 1, 0.01, (value) => (this.weights[index] = value)));
    }
  }

  jointSliders() {
    for (const name of JOINTS.filter((joint) => this.joints[joint])) {
      const turn = (this.turns[name] = new Euler());
      const rows = ["x", "y", "z"].map((axis) =>
        slider(axis, `${name}.${axis}`, -120, 120, 1, (degrees) => (turn[axis] = (degrees * Math.PI) / 180)),
      );
      $("joints").append(element("details", {}, element("summary", { textContent: name.replace("_", " ") }), ...rows));
    }
  }

  clipList() {
    const clips = this.gltf.animations;
    $("clips").hidden = !clips.length;
    $("clip").append(element("option", { value: "", textContent: "no clip: sliders alone" }));
    for (const clip of clips) $("clip").append(element("option", { value: clip.name, textContent: clip.name }));
    $("clip").onchange = () => this.choose($("clip").value);
    $("play").onclick = () => {
      this.playing = !this.playing;
      $("play").textContent = this.playing ? "pause" : "play";
    };
    $("time").oninput = () => {
      this.playing = false;
      $("play").textContent = "play";
      this.time = Number($("time").value) * (this.clip ? this.clip.duration : 0);
    };
    if (clips.length) {
      $("clip").value = clips[0].name;
      this.choose(clips[0].name);
    }
  }

  choose(name) {
    this.clip = this.gltf.animations.find((clip) => clip.name === name) || null;
    this.time = 0;
    this.tracks = (this.clip ? this.clip.tracks : []).map((track) => {
      const cut = track.name.lastIndexOf(".");
      return { node: track.name.slice(0, cut), property: track.name.slice(cut + 1), at: track.createInterpolant() };
    });
  }

  pose() {
    for (const [joint, quaternion, position] of this.rest) {
      joint.quaternion.copy(quaternion);
      joint.position.copy(position);
    }
    const influences = this.mesh.morphTargetInfluences;
    influences.fill(0);
    for (const { node, property, at } of this.clip ? this.tracks : []) {
      const value = at.evaluate(this.time);
      if (property === "morphTargetInfluences") influences.forEach((_, k) => (influences[k] = value[k]));
      else this.joints[node]?.[property].fromArray(value);
    }
    this.weights.forEach((weight, k) => (influences[k] += weight));
    for (const [name, turn] of Object.entries(this.turns)) {
      this.joints[name].quaternion.multiply(new Quaternion().setFromEuler(turn));
    }
  }

  frame(seconds) {
    if (this.clip && this.playing && this.clip.duration > 0) {
      this.time = (this.time + seconds) % this.clip.duration;
      $("time").value = this.time / this.clip.duration;
    }
    this.pose();
    this.renderer.render(this.stage, this.camera);
    document.body.dataset.ready = "1";
  }
}

$("reset").onclick = () => {
  for (const input of document.querySelectorAll("#expressions input, #joints input")) {
    input.value = 0;
    input.dispatchEvent(new Event("input"));
  }
};
new GLTFLoader().parse(
  bytes($("glb").textContent),
  "",
  (gltf) => (window.viewer = new Viewer(gltf)),
  (error) => ($("message").textContent = `The avatar could not be shown: ${error.message || error}`),
);
