"""Named body poses, hand poses and expressions. Degrees in the tables, left side; the right side is its mirror image."""

from __future__ import annotations

import difflib

import numpy as np

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES, HAND_JOINTS, JOINT_NAMES
from avatarrex.signals.signals import Signals

_Pose = dict[str, tuple[float, float, float]]
_MIRROR = np.array([1.0, -1.0, -1.0])
_ARMS_DOWN: _Pose = {"both_shoulder": (0, 0, -72), "both_elbow": (0, -12, 0)}
POSES: dict[str, _Pose] = {
    "tpose": {},
    "apose": {"both_shoulder": (0, 0, -45)},
    "stand": {"both_shoulder": (0, 0, -66), "both_elbow": (0, -14, 0), "left_hip": (0, 6, 2), "right_hip": (0, -6, -2)},
    "wave": {**_ARMS_DOWN, "right_shoulder": (0, 15, -25), "right_elbow": (0, 0, -95), "head": (0, -8, 4)},
    "arms_up": {"both_shoulder": (0, -10, 68), "both_collar": (0, 0, 15)},
    "squat": {"both_hip": (-95, 12, 14), "both_knee": (115, 0, 0), "both_ankle": (-22, 0, 0), "spine1": (22, 0, 0),
              "both_shoulder": (0, -75, -12)},
    "sit": {"both_hip": (-85, 0, 6), "both_knee": (85, 0, 0), "both_shoulder": (0, -20, -62), "both_elbow": (0, -45, 0)},
    "walk": {"left_hip": (-28, 0, 0), "left_knee": (12, 0, 0), "right_hip": (18, 0, 0), "right_knee": (32, 0, 0),
             "left_shoulder": (28, 0, -70), "right_shoulder": (-25, 0, 70), "both_elbow": (0, -25, 0)},
    "run": {"left_hip": (-70, 0, 0), "left_knee": (85, 0, 0), "right_hip": (22, 0, 0), "right_knee": (50, 0, 0),
            "left_shoulder": (45, 0, -65), "right_shoulder": (-40, 0, 65), "both_elbow": (0, -90, 0), "spine2": (10, 0, 0)},
    "hands_on_hips": {"both_collar": (8, 15, -10), "both_shoulder": (21, 24, -64), "both_elbow": (-8, -94, -5),
                      "both_wrist": (5, -2, -16)},
    "think": {**_ARMS_DOWN, "right_shoulder": (0, 59, 43), "right_elbow": (7, 132, 5), "right_wrist": (-10, 25, -52),
              "head": (8, 0, -4)},
    "clasped_hands": {"both_shoulder": (34, -65, -62), "both_elbow": (-28, -47, -3), "both_wrist": (-10, -25, 42)},
    "star": {"both_shoulder": (0, 0, 30), "both_hip": (0, 0, 25)},
    "bow": {**_ARMS_DOWN, "spine1": (28, 0, 0), "spine2": (18, 0, 0), "both_hip": (-22, 0, 0), "head": (15, 0, 0)},
}  # fmt: skip
_FINGERS = ("index", "middle", "ring", "pinky")


def _curl(degrees: tuple[float, float, float], fingers: tuple[str, ...] = _FINGERS) -> _Pose:
    return {f"{finger}{k + 1}": (0, 0, -degrees[k]) for finger in fingers for k in range(3)}


HANDS: dict[str, _Pose] = {
    "flat": {},
    "relaxed": {**_curl((16, 24, 14)), "thumb2": (0, -12, 0)},
    "fist": {**_curl((78, 92, 62)), "thumb1": (20, -32, -10), "thumb2": (0, -38, 0), "thumb3": (0, -45, 0)},
    "point": {**_curl((78, 92, 62), ("middle", "ring", "pinky")), "thumb1": (20, -30, -10), "thumb2": (0, -38, 0), "thumb3": (0, -40, 0)},
    "pinch": {**_curl((28, 22, 12), ("middle", "ring", "pinky")), **_curl((48, 48, 25), ("index",)),
              "thumb1": (24, -26, -12), "thumb2": (0, -20, 0), "thumb3": (0, -18, 0)},
    "spread": {"index1": (0, 11, 3), "middle1": (0, 3, 3), "ring1": (0, -8, 3), "pinky1": (0, -15, 3), "thumb1": (0, 16, 6)},
    "thumbs_up": {**_curl((78, 92, 62)), "thumb1": (-18, 10, 10)},
    "victory": {**_curl((78, 92, 62), ("ring", "pinky")), "index1": (0, 9, 0), "middle1": (0, -8, 0),
                "thumb1": (24, -34, -10), "thumb2": (0, -42, 0), "thumb3": (0, -48, 0)},
}  # fmt: skip
EXPRESSIONS: dict[str, dict[str, float]] = {
    "neutral": {},
    "smile": {"mouthSmile*": 0.8, "cheekSquint*": 0.4, "eyeSquint*": 0.2},
    "laugh": {"mouthSmile*": 1.0, "jawOpen": 0.45, "cheekSquint*": 0.8, "eyeSquint*": 0.6},
    "surprise": {"jawOpen": 0.55, "eyeWide*": 1.0, "browInnerUp": 0.9, "browOuterUp*": 0.9},
    "anger": {"browDown*": 1.0, "noseSneer*": 0.6, "mouthPress*": 0.6, "eyeSquint*": 0.4},
    "sadness": {"mouthFrown*": 0.8, "browInnerUp": 0.9, "mouthShrugLower": 0.4},
    "disgust": {"noseSneer*": 1.0, "mouthUpperUp*": 0.6, "browDown*": 0.5},
    "blink": {"eyeBlink*": 1.0},
    "wink": {"eyeBlinkLeft": 1.0, "mouthSmileLeft": 0.5, "cheekSquintLeft": 0.6},
    "jaw_open": {"jawOpen": 1.0},
    "kiss": {"mouthPucker": 1.0},
    "puff": {"cheekPuff": 1.0},
    "funnel": {"mouthFunnel": 1.0, "jawOpen": 0.2},
}


def named_pose(name: str) -> np.ndarray:
    """θ (21, 3) of a named body pose. Raises `InputError` with the near matches."""
    pose = np.zeros((55, 3))
    for joint, degrees in _look_up("pose", name, POSES).items():
        sides = ("left", "right") if joint.startswith("both_") else ("",)
        for side in sides:
            full = joint.replace("both", side) if side else joint
            pose[JOINT_NAMES.index(full)] = np.radians(degrees) * (_MIRROR if side == "right" else 1.0)
    return pose[1:22]


def named_hand(name: str, side: str) -> np.ndarray:
    """φ (15, 3) of a named hand pose for side "left" or "right"."""
    pose = np.zeros((15, 3))
    for joint, degrees in _look_up("hand", name, HANDS).items():
        pose[HAND_JOINTS.index(joint)] = np.radians(degrees)
    return pose * (_MIRROR if side == "right" else 1.0)


def named_expression(name: str) -> np.ndarray:
    """ψ (52,) of a named expression."""
    value = np.zeros(52)
    for unit, amount in _look_up("expression", name, EXPRESSIONS).items():
        for full in [unit.replace("*", side) for side in ("Left", "Right")] if "*" in unit else [unit]:
            value[EXPRESSION_NAMES.index(full)] = amount
    return value


def mirror(signals: Signals) -> Signals:
    """The same signals seen in a mirror: left and right exchanged."""
    pose = signals.full_pose()
    swapped = pose.copy()
    for j, name in enumerate(JOINT_NAMES):
        side, _, rest = name.partition("_")
        other = {"left": "right_", "right": "left_"}.get(side)
        swapped[j] = pose[JOINT_NAMES.index(other + rest) if other else j] * _MIRROR
    order = [EXPRESSION_NAMES.index(_other_side(name)) for name in EXPRESSION_NAMES]
    mirrored = Signals.from_full_pose(swapped, expression=signals.expression[order], shape=signals.shape)
    return mirrored.replace(translation=signals.translation * np.array([-1.0, 1.0, 1.0]))


def _other_side(name: str) -> str:
    for a, b in (("Left", "Right"), ("Right", "Left")):
        if name.endswith(a):
            return name.removesuffix(a) + b
    return name


def _look_up(kind: str, name: str, table: dict[str, dict]) -> dict:
    if name not in table:
        near = difflib.get_close_matches(name, table, 3, 0.4) or list(table)
        raise InputError(kind, name, "one of " + ", ".join(near), "an unknown name")
    return table[name]
