"""Named body poses, hand poses and expressions. Degrees in the tables, left side; the right side is its mirror image."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.assets import DATA
from avatarrex.files.json_text import read_json
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import BODY_JOINTS, EXPRESSION_NAMES, HAND_JOINTS, JOINT_NAMES
from avatarrex.signals.limits import FLEXION

Turn = tuple[float, float, float]
"""A rotation vector in degrees."""
_Pose = dict[str, Turn]
_T = TypeVar("_T")
_MIRROR = np.array([1.0, -1.0, -1.0])


def _pose(entry: Mapping[str, list[float]]) -> _Pose:
    """An entry of a file."""
    return {joint: (x, y, z) for joint, (x, y, z) in entry.items()}


_ARMS_DOWN: _Pose = {"both_shoulder": (0, 0, -72), "both_elbow": (0, -12, 0)}
_FITTED: dict[str, _Pose] = {name: _pose(entry) for name, entry in read_json(DATA / "fitted_poses.json").items()}
"""Those that touch something, with their hands: made by `tools/fit_poses.py`."""
POSES: dict[str, _Pose] = {
    "tpose": {},
    "apose": {"both_shoulder": (0, 0, -45)},
    "stand": {"both_shoulder": (0, 0, -66), "both_elbow": (0, -14, 0), "left_hip": (0, 6, 2), "right_hip": (0, -6, -2)},
    "wave": {**_ARMS_DOWN, "right_shoulder": (-58, 15, 6), "right_elbow": (-10, 112, 0), "head": (0, -8, 4)},
    "arms_up": {"both_shoulder": (0, -10, 68), "both_collar": (0, 0, 15)},
    "squat": {"both_hip": (-95, 12, 14), "both_knee": (115, 0, 0), "both_ankle": (-22, 0, 0), "spine1": (22, 0, 0),
              "both_shoulder": (0, -75, -12)},
    "sit": {"both_hip": (-85, 0, 6), "both_knee": (85, 0, 0), "both_shoulder": (0, -20, -62), "both_elbow": (0, -45, 0)},
    "walk": {"left_hip": (-28, 0, 0), "left_knee": (12, 0, 0), "right_hip": (18, 0, 0), "right_knee": (32, 0, 0),
             "left_shoulder": (28, 0, -70), "right_shoulder": (-25, 0, 70), "both_elbow": (0, -25, 0)},
    "run": {"left_hip": (-70, 0, 0), "left_knee": (85, 0, 0), "right_hip": (22, 0, 0), "right_knee": (50, 0, 0),
            "left_shoulder": (45, 0, -65), "right_shoulder": (-40, 0, 65), "both_elbow": (0, -90, 0), "spine2": (10, 0, 0)},
    "point_forward": {**_ARMS_DOWN, "right_collar": (0, 10, 0), "right_shoulder": (0, 78, 4), "right_elbow": (0, 6, 0),
                      "spine3": (0, 6, 0), "head": (0, -4, 0), "left_hip": (0, 6, 2), "right_hip": (0, -6, -2)},
    "lunge": {**_ARMS_DOWN, "left_hip": (-78, 6, 4), "left_knee": (82, 0, 0), "right_hip": (24, -4, -4), "right_knee": (42, 0, 0),
              "right_ankle": (-14, 0, 0), "right_foot": (-28, 0, 0), "both_elbow": (0, -20, 0)},
    "jump": {"both_shoulder": (0, -15, 62), "both_collar": (0, 0, 14), "both_elbow": (0, -20, 0), "left_hip": (-42, 8, 10),
             "left_knee": (72, 0, 0), "right_hip": (-12, -8, -10), "right_knee": (58, 0, 0), "both_ankle": (32, 0, 0), "spine2": (-8, 0, 0),
             "head": (-12, 0, 0)},
    "dance": {"left_shoulder": (0, -10, 52), "left_elbow": (-20, -48, 0), "left_collar": (0, 0, 12),
              "right_shoulder": (-10, 35, 38), "right_elbow": (-20, 62, 0), "spine1": (0, -10, -8),
              "spine2": (0, -8, -8), "spine3": (0, -6, -4), "head": (-4, 12, 10),
              "left_hip": (-8, 10, 6), "left_knee": (10, 0, 0), "right_hip": (-42, -22, -22), "right_knee": (66, 0, 0),
              "right_ankle": (28, 0, 0)},
    "sit_floor": {"both_hip": (-93, 4, 9), "both_knee": (14, 0, 0), "both_ankle": (8, 0, 0), "spine1": (-6, 0, 0),
                  "both_collar": (0, 6, 0),
                  "both_shoulder": (28, 18, -56), "both_elbow": (0, -8, 0), "both_wrist": (0, 0, 52), "head": (6, 0, 0)},
    "star": {"both_shoulder": (0, 0, 30), "both_hip": (0, 0, 25)},
    "bow": {**_ARMS_DOWN, "spine1": (28, 0, 0), "spine2": (18, 0, 0), "both_hip": (-22, 0, 0), "head": (15, 0, 0)},
    "contrapposto": {"left_shoulder": (10, 8, -70), "left_elbow": (0, -22, 0), "right_shoulder": (-4, -4, 76), "right_elbow": (0, 16, 0),
                     "left_hip": (-9, 10, 7), "left_knee": (22, 0, 0), "left_ankle": (-12, 0, 0), "right_hip": (0, -4, 3),
                     "spine1": (0, 2, -5), "spine2": (0, 2, 5), "spine3": (0, 2, 4), "head": (2, -8, 3)},
    "hands_up": {"both_collar": (0, -6, 22), "both_shoulder": (-50, 10, -62), "both_elbow": (-70, -80, 0), "both_wrist": (-10, 0, -20),
              "head": (4, 0, 8)},
    "stop": {**_ARMS_DOWN, "right_collar": (0, 10, 0), "right_shoulder": (0, 74, 6), "right_elbow": (0, 15, 0), "right_wrist": (0, 0, -58),
             "left_hip": (0, 6, 2), "right_hip": (0, -6, -2)},
    "cheer": {**_ARMS_DOWN, "right_collar": (0, 0, -16), "right_shoulder": (-10, 30, -58), "right_elbow": (0, 35, 0), "spine2": (-6, 0, 0),
              "head": (-10, 0, 0), "left_hip": (0, 6, 2), "right_hip": (0, -6, -2)},
    "balance": {"both_shoulder": (0, -4, 4), "both_elbow": (0, -6, 0), "left_hip": (-72, 8, 4), "left_knee": (88, 0, 0),
                "left_ankle": (18, 0, 0), "right_hip": (0, -4, -1)},
    "kick": {"left_shoulder": (0, -50, -30), "right_shoulder": (20, -10, 52), "both_elbow": (0, -38, 0), "right_hip": (-84, -4, -4),
             "right_knee": (14, 0, 0), "right_ankle": (20, 0, 0), "left_hip": (8, 4, 2), "left_knee": (14, 0, 0), "left_ankle": (-14, 0, 0),
             "spine1": (-8, 0, 0), "spine2": (8, 0, 0)},
    "look_back": {**_ARMS_DOWN, "spine1": (0, 14, 0), "spine2": (0, 14, 0), "spine3": (0, 12, 0), "neck": (0, 26, 0), "head": (0, 28, 0),
                  "left_hip": (0, 6, 2), "right_hip": (0, -6, -2)},
    **_FITTED,
}  # fmt: skip
_FIST: _Pose = {
    "index1": (14, 36, -81), "index2": (13, 16, -75), "index3": (4, 5, -23),
    "middle1": (-13, 1, -94), "middle2": (-10, 4, -71), "middle3": (-7, 3, -47),
    "ring1": (-30, -3, -84), "ring2": (-26, 5, -72), "ring3": (-15, 3, -42),
    "pinky1": (-39, -28, -81), "pinky2": (-28, -6, -59), "pinky3": (-17, -3, -35),
}  # fmt: skip
_RELAXED: _Pose = {
    "index1": (2, 3, -13), "index2": (4, 5, -21), "index3": (2, 2, -12),
    "middle1": (-2, 1, -17), "middle2": (-3, 1, -24), "middle3": (-2, 1, -13),
    "ring1": (-6, 3, -18), "ring2": (-8, 2, -23), "ring3": (-4, 1, -12),
    "pinky1": (-9, 1, -18), "pinky2": (-11, -2, -23), "pinky3": (-6, -1, -12),
    "thumb1": (4, 10, -6), "thumb2": (4, 7, 0), "thumb3": (5, 8, 0),
}  # fmt: skip


def _but(base: _Pose, *open_fingers: str, **others: Turn) -> _Pose:
    """`base` without some fingers, with some joints of their own."""
    return {**{joint: turn for joint, turn in base.items() if joint[:-1] not in open_fingers}, **others}


def _curled(**fingers: tuple[float, float, float]) -> _Pose:
    """Fingers that close by so many degrees at knuckle, middle and tip, each about its own axis."""
    return {
        f"{finger}{k}": (x * angle, y * angle, z * angle)
        for finger, angles in fingers.items()
        for k, angle in enumerate(angles, 1)
        for x, y, z in (FLEXION[finger],)
    }


def _four(knuckle: float, middle: float, tip: float) -> _Pose:
    """The four fingers alike."""
    return _curled(**dict.fromkeys(("index", "middle", "ring", "pinky"), (knuckle, middle, tip)))


_ACROSS: _Pose = {"thumb1": (19, 44, -1), "thumb2": (13, 20, -1), "thumb3": (20, 31, -1)}
"""The thumb over the ring finger."""
_UP: _Pose = {"thumb1": (-22, -27, 26), "thumb2": (-4, -7, 0), "thumb3": (-6, -10, 0)}
"""The thumb away from a fist."""
_OPPOSED: _Pose = {"thumb1": (13, 16, 2), "thumb2": (11, 18, 0), "thumb3": (9, 14, 0)}
"""The thumb before the fingers."""
_PINCH: _Pose = {"index1": (8, 11, -48), "index2": (8, 10, -47), "index3": (5, 7, -31), **_OPPOSED}
HANDS: dict[str, _Pose] = {
    "flat": {},
    "relaxed": _RELAXED,
    "open": {**_four(6, 9, 6), "index1": (1, -5, -6), "pinky1": (-3, 9, -5), "thumb1": (-4, -8, 6)},
    "fist": _but(_FIST, thumb1=(-1, 31, -7), thumb2=(22, 34, -1), thumb3=(17, 27, -1)),
    "loose_fist": {**_curled(index=(48, 62, 34), middle=(56, 66, 36), ring=(60, 68, 38), pinky=(62, 68, 38)),
                   "thumb1": (8, 22, -4), "thumb2": (14, 22, -1), "thumb3": (12, 19, 0)},
    "point": _but(_FIST, "index", index1=(1, 1, -4), index2=(1, 1, -6), index3=(1, 1, -3), thumb1=(-28, 47, 0),
                  thumb2=(23, 37, -1), thumb3=(18, 28, -1)),
    "pinch": _but(_RELAXED, **_PINCH),
    "ok": {**_PINCH, **_curled(middle=(8, 12, 8), ring=(2, 8, 6), pinky=(-4, 6, 5)), "pinky1": (2, 8, 4)},
    "spread": {"index1": (0, -9, 3), "middle1": (0, -2, 3), "ring1": (0, 6, 3), "pinky1": (0, 14, 3), "thumb1": (-10, -22, 10)},
    "thumbs_up": _but(_FIST, **_UP),
    "victory": _but(_FIST, "index", "middle", **_ACROSS, index1=(0, -5, -2), middle1=(0, 6, -2)),
    "three": _but(_FIST, "index", "middle", "ring", index1=(0, -8, -2), ring1=(0, 8, -2), thumb1=(22, 46, -1),
                  thumb2=(16, 25, -1), thumb3=(24, 37, -1)),
    "horns": _but(_FIST, "index", "pinky", **_ACROSS, index1=(0, -3, -2), pinky1=(0, 8, -2)),
    "call_me": _but(_FIST, "pinky", **_UP, pinky1=(0, 14, -2)),
    "gun": _but(_FIST, "index", **_UP, index1=(1, 1, -3)),
    "grip": {**_four(46, 48, 30), "thumb1": (16, 22, 2), "thumb2": (8, 13, 0), "thumb3": (9, 14, 0)},
    "cup": {**_four(26, 24, 16), "thumb1": (8, 14, 2), "thumb2": (6, 9, 0)},
    "claw": {**_four(-8, 66, 52), "index1": (-1, -10, 8), "pinky1": (4, 12, 8), "thumb1": (-6, -6, 8), "thumb2": (14, 22, 0),
             "thumb3": (20, 31, 0)},
    "clasp": {**_four(38, 52, 30), "thumb1": (6, 14, 0), "thumb2": (8, 13, 0), "thumb3": (6, 9, 0)},
}  # fmt: skip
EXPRESSIONS: dict[str, dict[str, float]] = {
    "neutral": {},
    "relaxed": {"browDown*": 0.3, "eyeWide*": 0.2, "mouthSmile*": 0.22, "mouthDimple*": 0.1},
    "smile": {"mouthSmile*": 0.8, "cheekSquint*": 0.4, "eyeSquint*": 0.2},
    "grin": {"mouthSmile*": 0.9, "mouthUpperUp*": 0.35, "mouthLowerDown*": 0.25, "cheekSquint*": 0.6, "eyeSquint*": 0.35, "jawOpen": 0.06},
    "laugh": {"mouthSmile*": 1.0, "jawOpen": 0.45, "cheekSquint*": 0.8, "eyeSquint*": 0.6},
    "smirk": {"mouthSmileLeft": 0.7, "mouthDimpleLeft": 0.4, "cheekSquintLeft": 0.3, "browOuterUpLeft": 0.35},
    "surprise": {"jawOpen": 0.55, "eyeWide*": 1.0, "browInnerUp": 0.9, "browOuterUp*": 0.9},
    "fear": {"eyeWide*": 0.9, "browInnerUp": 1.0, "mouthStretch*": 0.7, "jawOpen": 0.2},
    "anger": {"browDown*": 0.85, "noseSneer*": 0.5, "mouthPress*": 0.6, "eyeSquint*": 0.4},
    "shout": {"jawOpen": 0.75, "browDown*": 0.8, "noseSneer*": 0.5, "mouthUpperUp*": 0.5, "mouthLowerDown*": 0.5, "eyeSquint*": 0.3},
    "sadness": {"mouthFrown*": 0.8, "browInnerUp": 0.9, "mouthShrugLower": 0.4},
    "disgust": {"noseSneer*": 1.0, "mouthUpperUp*": 0.6, "browDown*": 0.5, "eyeSquint*": 0.5},
    "doubt": {"browOuterUpLeft": 0.9, "browDownRight": 0.6, "mouthLeft": 0.3, "mouthPress*": 0.4},
    "focus": {"browDown*": 0.5, "eyeSquint*": 0.6, "mouthPress*": 0.4, "mouthRollLower": 0.3},
    "sleepy": {"eyeBlink*": 0.55, "browInnerUp": 0.25, "jawOpen": 0.05},
    "blink": {"eyeBlink*": 1.0},
    "wink": {"eyeBlinkLeft": 1.0, "mouthSmileLeft": 0.5, "cheekSquintLeft": 0.6},
    "look_left": {"eyeLookOutLeft": 0.8, "eyeLookInRight": 0.8},
    "look_right": {"eyeLookInLeft": 0.8, "eyeLookOutRight": 0.8},
    "look_up": {"eyeLookUp*": 0.8, "browOuterUp*": 0.2, "browInnerUp": 0.2},
    "jaw_open": {"jawOpen": 1.0},
    "kiss": {"mouthPucker": 1.0},
    "puff": {"cheekPuff": 1.0, "mouthPucker": 0.25, "mouthPress*": 0.3},
    "funnel": {"mouthFunnel": 1.0, "jawOpen": 0.2},
    "pout": {"mouthPucker": 0.4, "mouthShrugLower": 0.9, "mouthFrown*": 0.4, "browDown*": 0.3},
    "tongue_out": {"tongueOut": 1.0, "jawOpen": 0.4, "eyeSquint*": 0.3},
}  # fmt: skip


def named_pose(name: str) -> np.ndarray:
    """θ (21, 3) of a named body pose: rotation vectors in radians, SMPL-X order; `avatarrex.signals.library.POSES` lists them.

    Raises `InputError` with all names, the near ones first, for one that is none.
    """
    entry = _look_up("pose", name, POSES)
    return turned(
        np.zeros((21, 3)),
        {joint: turn for joint, turn in entry.items() if joint[-1].isalpha() or joint.startswith("spine")},
    )


def hands_of_pose(name: str) -> dict[str, np.ndarray]:
    """φ (15, 3) by `left_hand_pose`, `right_hand_pose`: the hands that a named body pose needs, such as clasped ones; none
    for most. Raises `InputError` as `named_pose` does.
    """
    entry = _look_up("pose", name, POSES)
    hands = {}
    for side in ("left", "right"):
        turns = {joint: entry[f"{side}_{joint}"] for joint in HAND_JOINTS if f"{side}_{joint}" in entry}
        if turns:
            pose = np.zeros((15, 3))
            pose[[HAND_JOINTS.index(joint) for joint in turns]] = np.radians(list(turns.values()))
            hands[f"{side}_hand_pose"] = pose
    return hands


def named_hand(name: str, side: str) -> np.ndarray:
    """φ (15, 3) of a named hand pose for `side` "left" or "right": rotation vectors in radians, MANO order (index, middle,
    pinky, ring, thumb × 3); `avatarrex.signals.library.HANDS` lists them.

    Raises `InputError` with all names, the near ones first, for one that is none.
    """
    pose = np.zeros((15, 3))
    for joint, degrees in _look_up("hand", name, HANDS).items():
        pose[HAND_JOINTS.index(joint)] = np.radians(degrees)
    return pose * (_MIRROR if side == "right" else 1.0)


def named_expression(name: str) -> np.ndarray:
    """ψ (52,) of a named expression: coefficients from 0 to 1 in Apple's order; `avatarrex.signals.library.EXPRESSIONS`
    lists them.

    Raises `InputError` with all names, the near ones first, for one that is none.
    """
    return coefficients(_look_up("expression", name, EXPRESSIONS))


def turned(base: np.ndarray, joints: Mapping[str, Turn]) -> np.ndarray:
    """θ (21, 3): `base` with some joints' rotations in degrees; `both_…` is the left one and, mirrored, the right."""
    pose = base.copy()
    for joint, degrees in joints.items():
        for side in ("left", "right") if joint.startswith("both_") else ("both",):
            turn = np.radians(degrees) * (_MIRROR if side == "right" else 1.0)
            pose[BODY_JOINTS.index(joint.replace("both", side))] = turn
    return pose


def coefficients(units: Mapping[str, float]) -> np.ndarray:
    """ψ (52,) of some face units by name; `…*` is the left one and the right."""
    value = np.zeros(52)
    for unit, amount in units.items():
        for side in ("Left", "Right"):
            value[EXPRESSION_NAMES.index(unit.replace("*", side))] = amount
    return value


def mirror(signals: Signals) -> Signals:
    """The same signals seen in a mirror: left and right exchanged."""
    pose = signals.full_pose()[_other_sides(JOINT_NAMES)] * _MIRROR
    mirrored = Signals.from_full_pose(pose, shape=signals.shape, translation=signals.translation * -_MIRROR)
    return mirrored.replace(expression=signals.expression[_other_sides(EXPRESSION_NAMES)])


def _other_sides(names: tuple[str, ...]) -> list[int]:
    """For each name the place of its counterpart on the other side; its own in the middle."""
    swap = {"left_": "right_", "right_": "left_", "Left": "Right", "Right": "Left"}
    return [names.index(re.sub("^left_|^right_|Left$|Right$", lambda side: swap[side[0]], name)) for name in names]


def _look_up(kind: str, name: str, table: Mapping[str, _T]) -> _T:
    if name not in table:
        names = dict.fromkeys([*difflib.get_close_matches(name, table, 3, 0.4), *table])
        raise InputError(kind, name, "one of " + ", ".join(names), "an unknown name")
    return table[name]
