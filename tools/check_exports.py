"""Every export, opened by a second, independent program: the table of docs/exports.md.

    python tools/check_exports.py DIR [--avatar AVATAR] [--motion FILE …] [--blender PYTHON] [--write docs/exports.md]

DIR has what npm gives (`npm install three@0.187.0 @pixiv/three-vrm gltf-validator esbuild puppeteer-core`) and gets `files/` and
`pictures/`, which are to be looked at. Chromium is Debian's (`CHROMIUM` names another); `--blender` is a Python with `bpy`. What is
missing is a line that says so; a check that fails ends with status 1.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.export.clips import Clip, read_clips
from avatarrex.export.export import export_avatar
from avatarrex.export.losses import Source
from avatarrex.export.rig import Rig, lifted, rig_of
from avatarrex.export.target import BONES
from avatarrex.files.gate import written
from avatarrex.files.images import composite
from avatarrex.levels import level
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose

SCRIPTS = Path(__file__).parent / "exports"
EVERY = 97
"""Every so many vertices are compared with ours."""
FRAME = 30
CLOSE = 1e-4
"""Metres: single precision through another program's matrices."""
MARKS = ("<!-- checks -->\n", "<!-- /checks -->\n")


@dataclass
class Check:
    """What is checked, and what was found."""

    folder: Path
    avatar: Avatar
    clips: tuple[Clip, ...]
    rows: list[tuple[str, str, str]] = field(default_factory=list)
    """File, program, finding."""
    failed: bool = False

    @property
    def pictures(self) -> Path:
        return self.folder / "pictures"

    def file(self, name: str) -> Path:
        return self.folder / "files" / name

    def say(self, name: str, program: str, finding: str, good: bool = True) -> None:
        """A row of the table."""
        self.rows.append((name, program, finding if good else f"**failed**: {finding}"))
        self.failed |= not good
        print(" | ".join(self.rows[-1]), flush=True)

    def rig(self, bones: int = 8) -> Rig:
        assert self.avatar.surface is not None
        light = np.ones_like(self.avatar.surface.vertices)  # places alone are compared
        return rig_of(self.avatar.surface, self.avatar.person, light).limited(bones)

    def frame(self) -> Signals:
        return self.clips[0].sequence[FRAME]


def write_files(check: Check) -> None:
    """Every format once; its size and its table."""
    plans: dict[str, tuple[Clip, ...]] = {
        "a.glb": check.clips, "a.vrm": (), "a.usdz": check.clips, "a.html": check.clips,
        "a.obj": read_clips((), ["walk"]), "a.ply": read_clips((), ["walk"]),
    }  # fmt: skip
    check.file("a").parent.mkdir(parents=True, exist_ok=True)
    check.pictures.mkdir(exist_ok=True)
    for name, clips in plans.items():
        exported = export_avatar(check.avatar, check.file(name), clips)
        size = sum(path.stat().st_size for path in exported.files)
        losses = exported.label.losses
        place = [
            losses[f"place against the whole surface, mm, {kind}"] for kind in ("mean", "p99") if name[1:] in BONES
        ]
        lost = ", ".join(f"{float(value):.2f}" for value in place)
        check.say(name, "written", f"{size / 1e6:.2f} MB" + (f"; mean, p99 {lost} mm" if place else ""))


def run(command: list[str], folder: Path) -> list[str]:
    """Lines that a program prints; its last words where it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=900)
    if done.returncode:
        raise OSError((done.stderr or done.stdout).strip().splitlines()[-1])
    return done.stdout.splitlines()


def check_validator(check: Check) -> None:
    """Khronos' validator."""
    command = ["node", str(SCRIPTS / "validate.mjs"), str(check.file("a.glb")), str(check.file("a.vrm"))]
    for name, line in zip(("a.glb", "a.vrm"), run(command, check.folder)):
        found = json.loads(line)
        issues = f"{found['numErrors']} errors, {found['numWarnings']} warnings, {found['numInfos']} infos"
        check.say(name, "gltf-validator", issues, not found["numErrors"])


def check_three(check: Check) -> None:
    """three.js and @pixiv/three-vrm in Chromium."""
    bundle = ["node_modules/.bin/esbuild", "page.js", "--bundle", "--format=iife", "--outfile=page.bundle.js"]
    (check.folder / "page.js").write_bytes((SCRIPTS / "page.js").read_bytes())
    run(bundle, check.folder)
    clip = check.clips[0]
    shown = {"name": "clip", "clip": clip.name, "time": FRAME / clip.sequence.fps, "every": EVERY}
    found = _browser(check, "glb", [{"name": "rest"}, shown, {"name": "morph", "face": True, "morph": {"jawOpen": 1}}])
    ours = check.rig(4).moved(check.frame())[check.rig().uv_vertex][::EVERY]
    error = np.abs(np.array(found["vertices"]["clip"]) - ours).max()
    facts = found["facts"]
    words = f"{facts['bones']} bones, {facts['morphs']} morph targets, {len(facts['clips'])} clips; frame {FRAME} within {error:.1e} m"
    check.say("a.glb", "three.js 0.187, Chromium", words, error < CLOSE and _moved(check, "glb_rest", "glb_clip"))
    turn = float(np.radians(-66))
    bones = {"name": "bones", "bones": {"leftUpperArm": [0, 0, turn]}, "every": EVERY}
    happy = {"name": "happy", "face": True, "expression": {"happy": 1, "aa": 0.5}}
    found = _browser(check, "vrm", [{"name": "rest"}, bones, {"name": "face", "face": True}, happy])
    pose = np.zeros((21, 3))
    pose[15] = [0, 0, turn]  # the left shoulder
    ours = check.rig(4).moved(Signals.rest().replace(body_pose=pose))[check.rig().uv_vertex][::EVERY]
    error, facts = np.abs(np.array(found["vertices"]["bones"]) - ours).max(), found["facts"]["vrm"]
    words = (
        f"VRM {facts['version']}: {facts['humanBones']} bones, {len(facts['presets'])} presets, {facts['custom']} custom; "
        f"authors {', '.join(facts['authors'])}; a raised arm within {error:.1e} m"
    )
    check.say("a.vrm", "@pixiv/three-vrm, Chromium", words, error < CLOSE and _moved(check, "vrm_face", "vrm_happy"))


def check_look(check: Check) -> None:
    """three.js' pictures beside the studio's own of level `live`, by the same camera."""
    wide, high = 512, 640  # of page.js, as distance, height and angle are
    angle = 2 * np.degrees(np.arctan(np.tan(np.radians(32 / 2)) * wide / high))
    assert check.avatar.surface is not None
    floor = lifted(check.avatar.surface)[1]
    for name, signals in (("rest", Signals.rest()), ("clip", check.frame())):
        camera = Camera.orbit(0, 0, 3.9, float(angle), (0.0, 0.9 - floor, 0.0), wide, high)
        drawn = render_frame(check.avatar, signals, camera, level("live")).image
        ours = composite(drawn, (0x2B / 255, 0x2F / 255, 0x36 / 255, 1.0))[..., :3].astype(np.float64)
        with Image.open(check.pictures / f"glb_{name}.png") as image:
            theirs = np.asarray(image.convert("RGB"), np.float64)
        inside = (drawn[..., 3].numpy() == 1) & (np.abs(theirs - [0x2B, 0x2F, 0x36]).max(-1) > 2)
        error = float(10 * np.log10(255**2 / np.mean((ours - theirs)[inside] ** 2)))
        beside = np.concatenate([theirs, ours, np.clip(np.abs(ours - theirs) * 3, 0, 255)], 1)
        Image.fromarray(beside.astype(np.uint8)).save(check.pictures / f"beside_{name}.png")
        say = f"{name}: {error:.1f} dB inside both against level live"
        check.say("a.glb", "three.js beside the studio", say, error > 15)


def check_page(check: Check) -> None:
    """The page from file://, its sliders and clips."""
    found = _browser(check, "html", [])
    shares = {kind: _changed(check, *pair) for kind, pair in {
        "joint": ("html_rest", "html_joint"), "expression": ("html_face_rest", "html_face_moved"), "clip": ("html_rest", "html_clip"),
    }.items()}  # fmt: skip
    words = ", ".join(f"{kind} {100 * share:.1f} %" for kind, share in shares.items())
    good = min(shares.values()) > 0.002 and not found["problems"]
    problems = "; ".join(found["problems"]) or "no message on the console"
    check.say(
        "a.html",
        "Chromium, file://",
        f"{found['facts']['sliders']} sliders; pixels changed by {words}; {problems}",
        good,
    )


def _browser(check: Check, kind: str, tasks: list[dict[str, Any]]) -> dict[str, Any]:
    file = check.file(f"a.{kind}").resolve()
    script = str(SCRIPTS / "browser.mjs")
    lines = run(["node", script, kind, str(file), str(check.pictures.resolve()), json.dumps(tasks)], check.folder)
    answer: dict[str, Any] = json.loads(lines[-1])
    return answer


def _changed(check: Check, first: str, second: str) -> float:
    """Share of pixels that differ by more than eight steps; of a page, those left of its panel."""
    images = []
    for name in (first, second):
        with Image.open(check.pictures / f"{name}.png") as image:
            images.append(np.asarray(image.convert("RGB"), int)[:, :760])
    return float((np.abs(images[0] - images[1]).max(-1) > 8).mean())


def _moved(check: Check, first: str, second: str) -> bool:
    return _changed(check, first, second) > 0.002


def check_blender(check: Check, python: str) -> None:
    """Blender's importer, evaluated mesh and picture."""
    clip = check.clips[0]
    number = round(FRAME * 30 / clip.sequence.fps) + 1  # the first frame of an action is 1
    script, file = str(SCRIPTS / "blender.py"), str(check.file("a.glb").resolve())
    command = [python, script, file, str(check.pictures.resolve()), clip.name, str(number), "jawOpen", str(EVERY)]
    facts = json.loads(next(line for line in run(command, check.folder) if line.startswith("FACTS "))[6:])
    error = _nearest(check.rig().moved(check.frame()), facts["posed"])
    morph = check.rig()
    jaw = np.zeros(52)
    jaw[[item.name for item in morph.morphs].index("jawOpen")] = 1
    opened = _nearest(morph.moved(Signals.rest().replace(expression=jaw)), facts["morphed"])
    words = (
        f"Blender {facts['blender']}: {facts['bones']} bones, {facts['shape keys']} shape keys, actions {', '.join(facts['actions'])}, "
        f"{facts['groups of a vertex, most']} joints of a vertex; frame {FRAME} within {error:.1e} m, jawOpen {opened:.1e} m"
    )
    check.say("a.glb", "bpy", words, max(error, opened) < CLOSE)


def _nearest(ours: np.ndarray, theirs: list[list[float]]) -> float:
    """Farthest that a vertex of theirs, whose order is their own, is from one of ours."""
    from scipy.spatial import cKDTree

    return float(cKDTree(ours).query(np.array(theirs))[0].max())


def check_usd(check: Check) -> None:
    """The validators that `usdchecker` runs: of the package, the stage, geometry, skeleton and shaders."""
    from pxr import Usd, UsdValidation

    stage = Usd.Stage.Open(str(check.file("a.usdz")))
    registry = UsdValidation.ValidationRegistry()
    names = [item.name for item in registry.GetAllValidatorMetadata() if not item.isSuite]
    context = UsdValidation.ValidationContext(registry.GetOrLoadValidatorsByName(names))
    found = [f"{error.GetName()}: {error.GetMessage()}" for error in context.Validate(stage)]
    words = f"{len(found)} errors of {len(names)} validators; {sum(1 for _ in stage.Traverse())} prims"
    version = ".".join(map(str, Usd.GetVersion()[1:]))
    check.say("a.usdz", f"UsdValidation {version}", words + "".join(f"; {line}" for line in found[:2]), not found)


def check_trimesh(check: Check) -> None:
    """OBJ and PLY."""
    source = Source(check.avatar.surface, check.avatar.person, check.avatar.light)  # type: ignore[arg-type]
    signals = Signals.rest().replace(body_pose=named_pose("walk"))
    ours = source.world(source.posed(signals), signals)
    for name in ("a.obj", "a.ply"):
        mesh = trimesh.load(check.file(name), process=False)
        error = _nearest(ours, mesh.vertices)
        visual = mesh.visual
        look = (
            f"texture {visual.material.image.size}"
            if name == "a.obj"
            else f"{len(visual.vertex_colors):,} vertex colours"
        )
        words = f"{len(mesh.vertices):,} vertices within {error:.1e} m, {len(mesh.faces):,} triangles, {look}"
        check.say(name, f"trimesh {trimesh.__version__}", words, error < CLOSE)


def attempt(check: Check, name: str, step: Callable[[], None]) -> None:
    """A step; what hinders it is a row."""
    try:
        step()
    except (OSError, ImportError, subprocess.SubprocessError, StopIteration) as error:
        check.say(name, "—", f"not checked: {error}", False)


def table(check: Check, command: str) -> str:
    """The rows in Markdown."""
    rows = "".join(f"| `{name}` | {program} | {finding} |\n" for name, program, finding in check.rows)
    return f"`{command}`\n\n| file | program | finding |\n|---|---|---|\n{rows}"


def main() -> int:
    """Write, check, print; put the table into a document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--motion", action="append", default=[], help="the first is compared frame by frame")
    parser.add_argument("--blender", help="a Python with bpy")
    parser.add_argument("--write", type=Path, help="a document with the marks of the table")
    options = parser.parse_args()
    check = Check(options.folder.resolve(), load_avatar(options.avatar), read_clips(options.motion))
    write_files(check)
    steps = (check_validator, check_three, check_look, check_page, check_usd, check_trimesh)
    for name, step in zip(("a.glb, a.vrm", "a.glb", "a.glb", "a.html", "a.usdz", "a.obj, a.ply"), steps):
        attempt(check, name, lambda step=step: step(check))  # type: ignore[misc]
    if options.blender:
        attempt(check, "a.glb", lambda: check_blender(check, os.path.abspath(options.blender)))
    if options.write:
        before, rest = options.write.read_text(encoding="utf-8").split(MARKS[0])
        after = rest.split(MARKS[1])[1]
        motions = " ".join(f"--motion {Path(path).name}" for path in options.motion)
        command = f"python tools/check_exports.py DIR --avatar {options.avatar} {motions} --blender PYTHON"
        with written(options.write) as temporary:
            temporary.write_text(before + MARKS[0] + table(check, command) + MARKS[1] + after, encoding="utf-8")
    return int(check.failed)


if __name__ == "__main__":
    sys.exit(main())
