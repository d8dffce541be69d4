"""Motion files in the dialects of other makers, written from one motion of ours: what comes back is known.

`write` draws a `Dialect`: names, hierarchy, rest pose (a person's, or a bundle of bones), axes of world and rest, unit, order of
channels. The skeleton is the default person's, so that every direction of the file is the motion's own.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_hand, named_pose
from avatarrex.signals.rest_skeleton import rest_skeleton

INDEX = {name: j for j, name in enumerate(JOINT_NAMES)}
FRAMES = 24
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rotation from ours to a world whose up is +Z and whose forward is −Y."""
X_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""To one whose up is +X and whose forward is +Y."""


def steps(turn: float = 0.0) -> list[Signals]:
    """A walk with swinging, bent arms and fingers that close, `turn` degrees away from the camera."""
    frames = []
    for phase in np.linspace(0, 2 * np.pi, FRAMES, endpoint=False):
        pose = np.zeros((55, 3))
        pose[1:22] = named_pose("stand")
        pose[0] = [0, np.radians(turn) + 0.1 * np.sin(phase), 0]
        for side, sign in (("left", 1), ("right", -1)):
            swing = sign * np.sin(phase)
            bend = 0.15 + 0.45 * max(0.0, sign * np.cos(phase))
            pose[INDEX[f"{side}_hip"], 0] = -0.35 * swing - 0.1
            pose[INDEX[f"{side}_knee"], 0] = bend
            pose[INDEX[f"{side}_ankle"], 0] = 0.1 + 0.35 * swing - bend if swing < 0.9 else 0.0
            pose[INDEX[f"{side}_elbow"]] = [0, -sign * (0.5 + 0.3 * swing), 0]
            pose[INDEX[f"{side}_wrist"]] = [0, 0, 0.2 * sign * np.sin(2 * phase)]
        pose[INDEX["spine3"], 1] = -0.1 * np.sin(phase)
        pose[INDEX["neck"], 1] = pose[INDEX["head"], 1] = 0.1 * np.sin(2 * phase)
        pose[25:40] = named_hand("relaxed", "left") * (0.6 + 0.4 * np.sin(phase))
        pose[40:55] = named_hand("relaxed", "right") * (0.6 - 0.4 * np.sin(phase))
        frames.append(Signals.from_full_pose(pose, translation=np.array([0, -0.02 + 0.02 * np.cos(2 * phase), 0.0])))
    return frames


@dataclass(frozen=True)
class Dialect:
    """How one maker writes a BVH."""

    names: dict[str, str]
    """The file's name of each of our joints that it has."""
    bundle: int | None = None
    """The axis along which all bones rest; None: a person's pose."""
    world: np.ndarray = field(default_factory=lambda: np.eye(3))
    """From our axes to those in which the motion goes."""
    rest: np.ndarray = field(default_factory=lambda: np.eye(3))
    """From our axes to those in which the rest pose stands."""
    rest_pose: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Our local rotation vectors in the rest pose: arms down and the like."""
    above: tuple[str, ...] = ()
    """Joints above the hips that never turn."""
    dangling: bool = False
    """Whether feet rest along the shin."""
    feet: tuple[float, float] = (0.0, 0.0)
    """Radians by which the bones from ankles to toes are steeper than ours, and turned outwards: ankles and toes of other rigs."""
    unit: float = 0.01
    """Metres."""
    channels: str = "ZXY"


def names(side: Callable[[str, str], str], middle: dict[str, str], sided: dict[str, str]) -> dict[str, str]:
    """Names of both sides, of a rule for a side's names."""
    both = {f"{s}_{part}": side(s, name) for s in ("left", "right") for part, name in sided.items()}
    return {name: {**middle, **both}[name] for name in JOINT_NAMES if name in {**middle, **both}}


def _limbs(*parts: str) -> dict[str, str]:
    return dict(zip(("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist"), parts))


def _fingers(form: Callable[[str, int], str]) -> dict[str, str]:
    return {
        f"{finger}{k}": form(finger, k) for finger in ("index", "middle", "pinky", "ring", "thumb") for k in (1, 2, 3)
    }


def _initial(side: str, name: str) -> str:
    return f"{side[0]}{name}"


def _word(side: str, name: str) -> str:
    return f"{side.capitalize()}{name}"


def _dotted(side: str, name: str) -> str:
    return f"{name}.{side[0].upper()}"


SPINE = {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"}
MIXAMO = {
    **_limbs("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand"),
    **_fingers(lambda finger, k: f"Hand{finger.capitalize()}{k}"),
}
NUMBER = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}
DAZ = {
    **_limbs("Thigh", "Shin", "Foot", "Toe", "Collar", "Shldr", "ForeArm", "Hand"),
    **_fingers(lambda finger, k: f"{'Mid' if finger == 'middle' else finger.capitalize()}{k}"),
}
BONES = (("Proximal", "Medial", "Distal"), ("Metacarpal", "Proximal", "Distal"))
"""Of a finger and of a thumb."""
ARMS_DOWN = {"left_shoulder": (0.0, 0, -1.3), "right_shoulder": (0.0, 0, 1.3)}
DIALECTS: dict[str, Dialect] = {
    "mixamo": Dialect(names(lambda s, n: f"mixamorig:{_word(s, n)}", {k: f"mixamorig:{v}" for k, v in SPINE.items()}, MIXAMO)),
    "game engine bundle": Dialect(names(_word, SPINE, MIXAMO), bundle=0),
    "bundle along Y, Z-up": Dialect(names(_word, SPINE, MIXAMO), bundle=1, world=Z_UP, unit=1.0),
    "cmu": Dialect(
        names(_word, {**SPINE, "spine1": "LowerBack"}, _limbs("Hip", "Knee", "Ankle", "Toe", "Collar", "Shoulder", "Elbow", "Wrist")),
        unit=0.0254 / 0.45, channels="ZYX",
    ),
    "asf names": Dialect(
        names(
            _initial,
            {"pelvis": "root", "spine1": "lowerback", "spine2": "upperback", "spine3": "thorax", "neck": "lowerneck", "head": "head"},
            _limbs("femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius", "wrist"),
        ),
    ),
    "daz": Dialect(
        names(_initial, {**SPINE, "pelvis": "hip", "spine1": "abdomen", "spine2": "abdomen2", "spine3": "chest"}, DAZ),
        rest_pose=ARMS_DOWN,
    ),
    "mocapnet": Dialect(
        names(
            _initial, {"pelvis": "hip", "spine1": "abdomen", "spine3": "chest", "neck": "neck", "head": "head"},
            {**_limbs("Thigh", "Shin", "Foot", "toe1-1", "Collar", "Shldr", "ForeArm", "Hand")},
        ) | {f"{s}_{finger}{k}": f"finger{NUMBER[finger]}-{k}.{s[0]}" for s in ("left", "right") for finger in NUMBER for k in (1, 2, 3)},
        unit=0.1,
    ),
    "rokoko": Dialect(
        names(
            _word, {"pelvis": "Hips", "spine1": "Spine1", "spine2": "Spine2", "spine3": "Spine4", "neck": "Neck", "head": "Head"},
            {**_limbs("Thigh", "Shin", "Foot", "Toe", "Shoulder", "Arm", "ForeArm", "Hand"),
             **_fingers(lambda f, k: f"Finger{NUMBER[f]}{BONES[f == 'thumb'][k - 1]}")},
        ),
        unit=1.0, above=("Reference",),
    ),
    "xsens": Dialect(
        names(
            _word, {"pelvis": "Hips", "spine1": "Chest", "spine2": "Chest2", "spine3": "Chest4", "neck": "Neck", "head": "Head"},
            _limbs("Hip", "Knee", "Ankle", "Toe", "Collar", "Shoulder", "Elbow", "Wrist"),
        ),
        channels="YXZ",
    ),
    "makehuman": Dialect(
        names(
            _dotted, {"pelvis": "root", "spine1": "spine05", "spine2": "spine03", "spine3": "spine01", "neck": "neck01", "head": "head"},
            {**_limbs("upperleg01", "lowerleg01", "foot", "toe1-1", "clavicle", "upperarm01", "lowerarm01", "wrist"),
             **_fingers(lambda f, k: f"finger{NUMBER[f]}-{k}")},
        ),
        rest=Z_UP, world=Z_UP, unit=0.1,
    ),
    "rest along another up": Dialect(names(_word, SPINE, MIXAMO), rest=Z_UP),
    "rest along no axis": Dialect(names(_word, SPINE, MIXAMO), rest=Rotation.from_rotvec([0, 0.7, 0]).as_matrix()),
    "X-up world": Dialect(names(_word, SPINE, MIXAMO), world=X_UP, rest=X_UP, unit=0.001),
    "feet along the shin": Dialect(names(_word, SPINE, MIXAMO), dangling=True, feet=(0.25, 0.0)),
    "bundle with high ankles": Dialect(names(_word, SPINE, MIXAMO), bundle=0, feet=(0.25, 0.0)),
    "high ankles": Dialect(names(_word, SPINE, MIXAMO), feet=(0.25, 0.0)),
    "optitrack": Dialect(
        names(
            lambda s, n: f"Skeleton 001_{s[0].upper()}{n}",
            {k: f"Skeleton 001_{v}" for k, v in {"pelvis": "Hip", "spine1": "Ab", "spine3": "Chest", "neck": "Neck", "head": "Head"}.items()},
            _limbs("Thigh", "Shin", "Foot", "Toe", "Shoulder", "UArm", "FArm", "Hand"),
        ),
        channels="XYZ",
    ),
    "biped": Dialect(
        names(
            lambda s, n: f"Bip01 {s[0].upper()} {n}",
            {k: f"Bip01 {v}" for k, v in {**SPINE, "pelvis": "Pelvis"}.items()},
            {**_limbs("Thigh", "Calf", "Foot", "Toe0", "Clavicle", "UpperArm", "Forearm", "Hand"),
             **_fingers(lambda f, k: f"Finger{NUMBER[f] - 1}{k - 1 if k > 1 else ''}")},
        ),
        bundle=0, world=Z_UP, rest=Z_UP,
    ),
    "reallusion": Dialect(
        names(
            lambda s, n: f"CC_Base_{s[0].upper()}_{n}",
            {"pelvis": "CC_Base_Hip", "spine1": "CC_Base_Waist", "spine2": "CC_Base_Spine01", "spine3": "CC_Base_Spine02",
             "neck": "CC_Base_NeckTwist01", "head": "CC_Base_Head"},
            {**_limbs("Thigh", "Calf", "Foot", "ToeBase", "Clavicle", "Upperarm", "Forearm", "Hand"),
             **_fingers(lambda f, k: f"{'Mid' if f == 'middle' else f.capitalize()}{k}")},
        ),
    ),
}  # fmt: skip
"""One of each kind that users bring."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A dialect's skeleton and its motion. Letters: t frames, j joints of ours that it has."""

    joints: list[str]
    parents: list[int]
    offsets: np.ndarray
    """(j, 3), the file's unit."""
    local: np.ndarray
    """(t, j, 3, 3)."""
    path: np.ndarray
    """(t, 3) of the root."""
    ends: dict[str, np.ndarray]
    """Where last bones point, from their joints."""


def drawn(dialect: Dialect, frames: list[Signals]) -> Drawn:
    """The dialect's skeleton, moving as `frames` do."""
    person, pose = rest_skeleton(), np.stack([frame.full_pose() for frame in frames])
    turned, places = person.posed(pose)
    places = places + np.stack([frame.translation for frame in frames])[:, None]
    joints = [name for name in JOINT_NAMES if name in dialect.names]
    parents = [_parent(name, joints) for name in joints]
    frame = _rest_frames(dialect, joints)
    offsets = np.zeros((len(joints), 3))
    for k, parent in enumerate(parents):
        if parent >= 0:
            bone = _bone_of(dialect, joints[parent], joints[k])
            offsets[k] = frame[joints[parent]] @ bone / dialect.unit
    globals_ = np.stack([dialect.world @ turned[:, INDEX[name]] @ frame[name].T for name in joints], 1)
    local = globals_.copy()
    for k, parent in enumerate(parents):
        if parent >= 0:
            local[:, k] = np.swapaxes(globals_[:, parent], 1, 2) @ globals_[:, k]
    ends = {
        name: frame[name] @ bone / dialect.unit
        for name, bone in _tips().items()
        if name in joints and _last(name, joints)
    }
    return Drawn(joints, parents, offsets, local, places[:, 0] @ dialect.world.T / dialect.unit, ends)


def _parent(name: str, joints: list[str]) -> int:
    j = INDEX[name]
    while j > 0:
        j = rest_skeleton().parents[j]
        if JOINT_NAMES[j] in joints:
            return joints.index(JOINT_NAMES[j])
    return -1


def _last(name: str, joints: list[str]) -> bool:
    return all(_parent(other, joints) != joints.index(name) for other in joints)


def _tips() -> dict[str, np.ndarray]:
    """Our rest bones beyond the last joints."""
    sides = {"left": 1.0, "right": -1.0}
    tips = {f"{s}_wrist": np.array([0.09 * x, 0, 0]) for s, x in sides.items()}
    tips |= {f"{s}_foot": np.array([0, 0, 0.07]) for s in sides} | {"head": np.array([0, 0.18, 0])}
    person = rest_skeleton().joints
    for s in sides:
        for finger in NUMBER:
            a, b = INDEX[f"{s}_{finger}2"], INDEX[f"{s}_{finger}3"]
            tips[f"{s}_{finger}3"] = (person[b] - person[a]) * 0.8
        tips[f"{s}_wrist"] = person[INDEX[f"{s}_middle1"]] - person[INDEX[f"{s}_wrist"]]
    return tips


def _rest_frames(dialect: Dialect, joints: list[str]) -> dict[str, np.ndarray]:
    """From our rest directions to the file's, of each joint."""
    pose = np.zeros((1, 55, 3))
    for name, turn in dialect.rest_pose.items():
        pose[0, INDEX[name]] = turn
    globals_ = rest_skeleton().posed(pose)[0][0]
    frames = {name: dialect.rest @ globals_[INDEX[name]] for name in joints}
    rng = np.random.default_rng(7)
    bundled = joints if dialect.bundle is not None else [n for n in joints if dialect.dangling and n.endswith("_ankle")]
    for name in bundled:
        along = dialect.rest @ np.eye(3)[dialect.bundle] if dialect.bundle is not None else dialect.rest @ [0, -1.0, 0]
        bone = frames[name] @ _along(dialect, name, joints)
        twist = rng.uniform(-np.pi, np.pi) if dialect.bundle is not None else 0.0
        turn = Rotation.align_vectors(along[None], bone[None] / np.linalg.norm(bone))[0]
        frames[name] = (Rotation.from_rotvec(twist * along) * turn).as_matrix() @ frames[name]
    return frames


def _bone_of(dialect: Dialect, name: str, child: str) -> np.ndarray:
    """Our rest bone between two joints, but for a foot's of another rig."""
    bone = rest_skeleton().joints[INDEX[child]] - rest_skeleton().joints[INDEX[name]]
    if not child.endswith("_foot"):
        return np.asarray(bone)
    steep, out = dialect.feet
    turn = Rotation.from_rotvec([0, out if child.startswith("left") else -out, 0]) * Rotation.from_rotvec([steep, 0, 0])
    return np.asarray(turn.apply(bone))


def _along(dialect: Dialect, name: str, joints: list[str]) -> np.ndarray:
    """Our rest bone from a joint to what follows."""
    after = {"pelvis": "spine1", "spine3": "neck", "left_wrist": "left_middle1", "right_wrist": "right_middle1"}
    children = [other for other in joints if _parent(other, joints) == joints.index(name)]
    child = after.get(name) if after.get(name) in joints else children[0] if children else None
    return _bone_of(dialect, name, child) if child else _tips().get(name, np.array([0, 0, 0.1]))


def write(path: Path, dialect: Dialect, frames: list[Signals]) -> None:
    """A BVH of the dialect."""
    made = drawn(dialect, frames)
    order: list[int] = []

    def block(k: int) -> list[str]:
        order.append(k)
        name = made.joints[k]
        kind = "ROOT" if made.parents[k] < 0 and not dialect.above else "JOINT"
        turns = " ".join(f"{letter}rotation" for letter in dialect.channels)
        channels = f"6 Xposition Yposition Zposition {turns}" if kind == "ROOT" else f"3 {turns}"
        lines = [f"{kind} {dialect.names[name]}", "{", _offset(made.offsets[k]), f"CHANNELS {channels}"]
        for child in [c for c, parent in enumerate(made.parents) if parent == k]:
            lines += block(child)
        if name in made.ends:
            lines += ["End Site", "{", _offset(made.ends[name]), "}"]
        return [*lines, "}"]

    body = block(0)
    for name in reversed(dialect.above):
        # what is above the hips carries the path and never turns
        body = [f"ROOT {name}", "{", _offset(np.zeros(3)), "CHANNELS 3 Xposition Yposition Zposition", *body, "}"]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")  # one of many answers is one
        angles = Rotation.from_matrix(made.local.reshape(-1, 3, 3)).as_euler(dialect.channels, degrees=True)
    angles = angles.reshape(len(frames), -1, 3)
    rows = [
        " ".join(f"{value:.5f}" for value in [*made.path[t], *angles[t, order].ravel()]) for t in range(len(frames))
    ]
    path.write_text(
        "\n".join(["HIERARCHY", *body, "MOTION", f"Frames: {len(frames)}", "Frame Time: 0.0333333", *rows]) + "\n"
    )


def _offset(values: np.ndarray) -> str:
    return "OFFSET " + " ".join(f"{value:.6f}" for value in values)


def write_asf(folder: Path, name: str, frames: list[Signals]) -> Path:
    """An ASF and an AMC in CMU's manner: axes of bones of their own, the root's order and units as there."""
    made, rng = drawn(DIALECTS["asf names"], frames), np.random.default_rng(3)
    names = [DIALECTS["asf names"].names[joint] for joint in made.joints]
    # a bone has one end: joints that share a parent hang from bones of their own that never turn
    bones, rows = (
        [
            ":version 1.10",
            ":units",
            " mass 1.0",
            " length 0.45",
            " angle deg",
            ":root",
            " order TX TY TZ RX RY RZ",
            ":bonedata",
        ],
        [],
    )
    hierarchy, axes = [":hierarchy", " begin"], {}
    for k, joint in enumerate(made.joints):
        children = [c for c, parent in enumerate(made.parents) if parent == k]
        if k == 0 or len(children) > 1:
            helpers = [f"to_{names[c]}" for c in children]
            for helper, c in zip(helpers, children):
                bones += _bone(helper, made.offsets[c], None)
            if k:
                axes[k] = rng.uniform(-90, 90, 3).round(3)
                bones += _bone(names[k], np.zeros(3), axes[k])
            hierarchy.append(f"  {names[k]} {' '.join(helpers)}")
            hierarchy += [f"  {helper} {names[c]}" for helper, c in zip(helpers, children)]
        else:
            axes[k] = rng.uniform(-90, 90, 3).round(3)
            along = made.offsets[children[0]] if children else made.ends.get(joint, np.array([0, 0.1, 0]))
            bones += _bone(names[k], along, axes[k])
            hierarchy += [f"  {names[k]} {names[children[0]]}"] if children else []
    rows = [":FULLY-SPECIFIED", ":DEGREES"]
    for t in range(len(frames)):
        rows.append(str(t + 1))
        for k in range(len(names)):
            axis = Rotation.from_euler("xyz", axes[k], degrees=True).as_matrix() if k in axes else np.eye(3)
            angles = Rotation.from_matrix(axis.T @ made.local[t, k] @ axis).as_euler("xyz", degrees=True)
            values = [*made.path[t], *angles] if k == 0 else angles
            rows.append(f"{names[k]} " + " ".join(f"{value:.5f}" for value in values))
    (folder / f"{name}.asf").write_text("\n".join([*bones, *hierarchy, " end"]) + "\n")
    (folder / f"{name}_01.amc").write_text("\n".join(rows) + "\n")
    return folder / f"{name}_01.amc"


def _bone(name: str, along: np.ndarray, axis: np.ndarray | None) -> list[str]:
    length = float(np.linalg.norm(along))
    direction = along / length if length else np.array([0.0, 1.0, 0.0])
    lines = [
        " begin",
        f"  name {name}",
        "  direction " + " ".join(f"{v:.6f}" for v in direction),
        f"  length {length:.6f}",
    ]
    turns = [0.0, 0, 0] if axis is None else axis
    lines.append("  axis " + " ".join(f"{v:.3f}" for v in turns) + " XYZ")
    return [*lines, *([] if axis is None else ["  dof rx ry rz"]), " end"]
