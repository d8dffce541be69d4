// A GLB or VRM in three.js, posed by what the browser script calls: window.load(base64, vrm), window.show(what), window.facts().
import * as THREE from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";

const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
renderer.setSize(512, 640);
document.body.style.margin = 0;
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
scene.background = new THREE.Color(0x2b2f36);
const camera = new THREE.PerspectiveCamera(32, 512 / 640, 0.05, 50);
let gltf, vrm, mesh, mixer;

window.load = async (base64, asVrm) => {
  const loader = new GLTFLoader();
  if (asVrm) loader.register((parser) => new VRMLoaderPlugin(parser));
  const data = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)).buffer;
  gltf = await loader.parseAsync(data, "");
  vrm = gltf.userData.vrm;
  scene.add(vrm ? vrm.scene : gltf.scene);
  gltf.scene.traverse((node) => node.isSkinnedMesh && (mesh = node));
  mesh.frustumCulled = false;
  mixer = new THREE.AnimationMixer(gltf.scene);
};

window.show = ({ face, clip, time, expression, morph, bones }) => {
  if (clip) {
    mixer.stopAllAction();
    mixer.clipAction(THREE.AnimationClip.findByName(gltf.animations, clip)).play();
    mixer.setTime(time);
  }
  for (const [name, weight] of Object.entries(morph || {})) {
    mesh.morphTargetInfluences[mesh.morphTargetDictionary[name]] = weight;
  }
  for (const [name, weight] of Object.entries(expression || {})) vrm.expressionManager.setValue(name, weight);
  for (const [bone, turn] of Object.entries(bones || {})) {
    vrm.humanoid.getNormalizedBoneNode(bone).rotation.set(...turn);
  }
  if (vrm) vrm.update(0);
  camera.position.set(0, face ? 1.56 : 0.9, face ? 0.75 : 3.9);
  camera.lookAt(0, face ? 1.56 : 0.9, 0);
  renderer.render(scene, camera);
};

// Where the clip puts some vertices, by three's own skinning: compared with ours in Python.
window.vertices = (every) => {
  gltf.scene.updateMatrixWorld(true);
  const found = [];
  const point = new THREE.Vector3();
  for (let k = 0; k < mesh.geometry.attributes.position.count; k += every) {
    mesh.getVertexPosition(k, point);
    found.push(point.applyMatrix4(mesh.matrixWorld).toArray());
  }
  return found;
};

window.facts = () => ({
  clips: gltf.animations.map((clip) => [clip.name, clip.duration, clip.tracks.length]),
  morphs: Object.keys(mesh.morphTargetDictionary).length,
  bones: mesh.skeleton.bones.length,
  vrm: vrm && {
    version: vrm.meta.metaVersion, name: vrm.meta.name, authors: vrm.meta.authors, avatarPermission: vrm.meta.avatarPermission,
    copyright: vrm.meta.copyrightInformation,
    humanBones: Object.keys(vrm.humanoid.humanBones).length,
    presets: Object.keys(vrm.expressionManager.presetExpressionMap), custom: Object.keys(vrm.expressionManager.customExpressionMap).length,
  },
});
