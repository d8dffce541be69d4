"""Names and groups of the driving signal: 55 SMPL-X joints, 52 Apple blend shapes."""

from __future__ import annotations

FINGERS = ("index", "middle", "pinky", "ring", "thumb")
JOINT_NAMES: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle", "spine3",
    "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "jaw", "left_eye", "right_eye",
    *(f"{side}_{finger}{k}" for side in ("left", "right") for finger in FINGERS for k in (1, 2, 3)),
)  # fmt: skip
JOINT_ROWS: dict[str, slice] = {
    "global_orient": slice(0, 1), "body_pose": slice(1, 22), "jaw_pose": slice(22, 23), "eye_pose": slice(23, 25),
    "leye_pose": slice(23, 24), "reye_pose": slice(24, 25), "left_hand_pose": slice(25, 40), "right_hand_pose": slice(40, 55),
}  # fmt: skip
"""Rows of the 55 rotation vectors by SMPL-X's names of the parts of a pose."""
BODY_JOINTS = JOINT_NAMES[1:22]
HAND_JOINTS = tuple(f"{finger}{k}" for finger in FINGERS for k in (1, 2, 3))
EXPRESSION_NAMES: tuple[str, ...] = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft", "eyeWideLeft",
    "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight", "eyeSquintRight",
    "eyeWideRight", "jawForward", "jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRight",
    "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight", "mouthDimpleLeft",
    "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower",
    "mouthShrugUpper", "mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft",
    "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff",
    "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip
FACE_REGIONS = ("brow", "eye", "jaw", "mouth", "cheek", "nose", "tongue")
"""What the names of the coefficients begin with."""
BODY_GROUPS: dict[str, tuple[str, ...]] = {
    "torso": ("spine1", "spine2", "spine3"),
    "head": ("neck", "head"),
    "left arm": ("left_collar", "left_shoulder", "left_elbow", "left_wrist"),
    "right arm": ("right_collar", "right_shoulder", "right_elbow", "right_wrist"),
    "left leg": ("left_hip", "left_knee", "left_ankle", "left_foot"),
    "right leg": ("right_hip", "right_knee", "right_ankle", "right_foot"),
}
_ALONG_Y, _ALONG_X = ("bend", "twist", "side"), ("twist", "bend", "side")
_AXES = {"shoulder": _ALONG_X, "elbow": _ALONG_X, "collar": _ALONG_X, "wrist": ("twist", "side", "bend"), "thumb": _ALONG_X,
         **dict.fromkeys(("index", "middle", "ring", "pinky"), ("twist", "side", "bend"))}  # fmt: skip


def axis_names(joint: str) -> tuple[str, str, str]:
    """What a turn of a joint about its x, y and z is called: along the bone it is a twist, about its main hinge a bend."""
    part = joint.removeprefix("left_").removeprefix("right_").rstrip("123")
    return _AXES.get(part, _ALONG_Y)
