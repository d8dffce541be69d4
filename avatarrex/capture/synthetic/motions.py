"""Motions of the synthetic capture: a body that moves casually, a face that expresses and speaks. All made here, none recorded.

A motion is a list of keys, one every 1.2 s for the body and 0.25 s for the face; between keys every rotation vector and
coefficient follows a monotone cubic (PCHIP), which neither overshoots nor leaves the hull of its keys. `seed` varies the keys'
amplitudes, the hands, the expressions and a slow sway. Frames sample the motion evenly, so that a short capture covers the
same poses as a long one. Body joints stay within the joint limits and the lower foot on the floor.

Letters: t frames, k keys. Radians and metres; degrees in the tables.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import grounded
from avatarrex.signals.joints import BODY_JOINTS, EXPRESSION_NAMES, JOINT_NAMES, JOINT_ROWS
from avatarrex.signals.library import Turn, coefficients, named_expression, named_hand, named_pose, turned
from avatarrex.signals.limits import clamp
from avatarrex.signals.sequence import SignalSequence

BODY_KEY, FACE_KEY = 1.2, 0.25
"""Seconds between keys."""
_DOWN: dict[str, Turn] = {
    "both_shoulder": (0, 0, -66),
    "both_elbow": (0, -16, 0),
    "left_hip": (0, 6, 2),
    "right_hip": (0, -6, -2),
}
_HIPS: dict[str, Turn] = {
    "both_collar": (9, 13.3, -10.3),
    "both_shoulder": (28.6, 16.2, -55.1),
    "both_elbow": (-12.3, -97.9, -8.1),
    "both_wrist": (-2.9, 5.9, -28.2),
}
"""Hands on the hips as captures have had them from the first: figures of trainings rest on the same pictures."""


@dataclass(frozen=True)
class BodyKey:
    """A named library pose, `_HIPS`, or joints over the standing pose, at one moment."""

    pose: str = "stand"
    joints: dict[str, Turn] = field(default_factory=dict)
    yaw: float = 0.0
    """Degrees that the whole person has turned."""
    hands: str = ""
    """Hand pose of the moment; empty: drawn by the seed."""


def _key(pose: str = "stand", yaw: float = 0.0, hands: str = "", **joints: Turn) -> BodyKey:
    return BodyKey(pose, joints, yaw, hands)


BODY_KEYS: tuple[BodyKey, ...] = (
    _key(),
    _key(spine1=(0, 6, 4), head=(0, 22, 0), left_hip=(0, 4, 6), right_hip=(-4, -6, 2), right_knee=(10, 0, 0)),
    _key(spine1=(2, -6, -4), head=(6, -24, 2), right_hip=(0, -4, -6), left_hip=(-4, 6, -2), left_knee=(10, 0, 0)),
    _key("walk", yaw=8),
    _key(yaw=4, right_hip=(-30, -2, 0), right_knee=(48, 0, 0), both_shoulder=(0, 0, -70)),
    _key(yaw=-4, left_hip=(18, 0, 0), left_knee=(32, 0, 0), right_hip=(-28, 0, 0), right_knee=(12, 0, 0),
         left_shoulder=(-25, 0, -70), right_shoulder=(28, 0, 70), both_elbow=(0, -25, 0), spine2=(0, 6, 0)),
    _key("walk", yaw=-8, spine2=(0, -6, 0), head=(0, 8, 0)),
    _key(yaw=0, left_hip=(-40, 4, 2), left_knee=(62, 0, 0), both_shoulder=(0, 0, -62), both_elbow=(0, -30, 0)),
    _key(left_shoulder=(0, -4, 6), left_collar=(0, 0, 5), left_elbow=(0, -8, 0), head=(0, 18, -4)),
    _key(left_shoulder=(0, -10, 58), left_collar=(0, 0, 12), right_shoulder=(0, 4, 30), head=(-10, 10, 0)),
    _key("arms_up", head=(-8, 0, 0)),
    _key("star", both_shoulder=(0, -6, 12), left_hip=(0, 4, 14), right_hip=(0, -4, -14)),
    _key("apose", spine3=(4, 0, 0)),
    _key(both_hip=(-48, 8, 9), both_knee=(58, 0, 0), both_ankle=(-12, 0, 0), spine1=(14, 0, 0), both_shoulder=(0, -50, -30)),
    _key("squat", both_hip=(-84, 12, 14), both_knee=(100, 0, 0), both_ankle=(-18, 0, 0)),
    _key(both_hip=(-38, 8, 9), both_knee=(46, 0, 0), both_ankle=(-8, 0, 0), spine1=(10, 0, 0), both_shoulder=(-10, -30, -38)),
    _key(spine1=(0, 14, 0), spine2=(0, 12, 0), spine3=(0, 10, 0), head=(0, 14, 0), both_shoulder=(0, -12, -22),
         both_elbow=(0, -38, 0)),
    _key(spine1=(0, -14, 0), spine2=(0, -12, 0), spine3=(0, -10, 0), head=(0, -16, 0), both_shoulder=(0, -12, -14),
         both_elbow=(0, -30, 0)),
    _key("wave", yaw=6),
    _key("wave", yaw=6, right_elbow=(-10, 84, 0), right_shoulder=(-50, 10, 14), head=(0, -4, -6)),
    _key(both_shoulder=(14, 8, -40), both_elbow=(-6, -60, -4), both_wrist=(-2, 3, -14)),
    _key("hands_on_hips", hands="relaxed", both_shoulder=(28.6, 16.2, -50)),
    _key("hands_on_hips", hands="relaxed", both_shoulder=(28.6, 16.2, -50), spine1=(4, 8, 5), spine2=(2, 6, 4),
         head=(4, -14, -4), left_hip=(0, 6, 5)),
    _key(both_shoulder=(14, 8, -40), both_elbow=(-6, -56, -4), both_wrist=(-2, 3, -14), spine1=(2, -4, 0)),
    _key("point_forward", yaw=-6, hands="point"),
    _key(right_shoulder=(0, 70, -38), right_elbow=(0, 8, 0), spine1=(4, 8, -6), spine2=(2, 8, -6), head=(-14, 6, 0)),
    _key("bow", both_shoulder=(0, -34, -56), both_elbow=(0, -14, 0), both_knee=(12, 0, 0)),
    _key(left_shoulder=(0, -70, 18), left_elbow=(0, -10, 0), left_collar=(0, -8, 4), spine3=(0, -6, 0), yaw=4),
    _key(left_shoulder=(-50, -12, -8), left_elbow=(-10, -100, 0), head=(0, 8, -4), yaw=8),
    _key("lunge", left_hip=(-62, 6, 4), left_knee=(64, 0, 0), right_hip=(20, -4, -4), right_knee=(34, 0, 0)),
    _key(yaw=-4, right_hip=(-24, -4, -3), right_knee=(34, 0, 0), both_shoulder=(0, -16, -52), both_elbow=(0, -50, 0)),
    _key(both_shoulder=(0, -34, -42), both_elbow=(-30, -72, 0), both_wrist=(0, -6, 10), head=(10, 0, 0)),
    _key(both_shoulder=(-18, -20, -46), both_elbow=(-20, -84, 0), both_wrist=(10, 0, -10), head=(-4, 6, 3)),
    _key("dance", left_hip=(-4, 8, 5), right_hip=(-34, -18, -18)),
    _key(),
)  # fmt: skip
"""Every hand on the hip is reached through a key with the elbow out, so that it never passes through the body."""

EXPRESSIONS = (
    "neutral", "smile", "laugh", "neutral", "surprise", "anger", "neutral", "sadness", "disgust", "wink", "kiss", "puff",
    "funnel", "jaw_open", "neutral",
)  # fmt: skip
_EXPRESSIONS: dict[str, dict[str, float]] = {
    "anger": {"browDown*": 1.0, "noseSneer*": 0.6, "mouthPress*": 0.6, "eyeSquint*": 0.4},
    "disgust": {"noseSneer*": 1.0, "mouthUpperUp*": 0.6, "browDown*": 0.5},
    "puff": {"cheekPuff": 1.0},
}
"""Of `EXPRESSIONS`, those that captures have in another strength than the library, for the reason of `_HIPS`."""
HANDS = ("flat", "relaxed", "fist", "point", "pinch", "spread", "victory")
VISEMES: dict[str, dict[str, float]] = {
    "aa": {"jawOpen": 0.52, "mouthLowerDown*": 0.22, "mouthUpperUp*": 0.14},
    "ee": {"jawOpen": 0.16, "mouthStretch*": 0.42, "mouthSmile*": 0.34, "mouthLowerDown*": 0.22},
    "ih": {"jawOpen": 0.24, "mouthStretch*": 0.2, "mouthUpperUp*": 0.14},
    "oh": {"jawOpen": 0.34, "mouthFunnel": 0.62},
    "oo": {"jawOpen": 0.12, "mouthPucker": 0.72, "mouthFunnel": 0.24},
    "mm": {"mouthPress*": 0.42, "mouthRollLower": 0.32, "mouthRollUpper": 0.28},
    "ff": {"jawOpen": 0.08, "mouthRollLower": 0.42, "mouthUpperUp*": 0.24},
    "ss": {"jawOpen": 0.07, "mouthStretch*": 0.3, "mouthLowerDown*": 0.26, "mouthUpperUp*": 0.2},
    "th": {"jawOpen": 0.2, "tongueOut": 0.22},
    "rest": {},
}
SENTENCE = [
    "rest", "mm", "aa", "ih", "rest", "ss", "ee", "oo", "mm", "oh", "rest", "ff", "aa", "th", "ee", "rest", "oo", "ih", "ss",
    "aa", "mm", "rest",
]  # fmt: skip


def body_motion(frames: int, seed: int, girth: float = 0.0) -> SignalSequence:
    """`frames` body frames that cover all of `BODY_KEYS`, with moving hands and a lively face.

    `girth`: degrees by which upper arms stay further out where hands would touch the body: cloth that stands off it.
    """
    rng = np.random.default_rng([seed, 1])
    times = np.arange(len(BODY_KEYS)) * BODY_KEY
    at = _sampled(times, frames)
    keyed = np.stack([_body_pose(key, 1 + 0.12 * rng.uniform(-1, 1), girth) for key in BODY_KEYS])
    pose = np.zeros((frames, 55, 3))
    pose[:, 1:22] = PchipInterpolator(times, keyed)(at) + _sway(at, rng)
    pose[:, 0, 1] = PchipInterpolator(times, np.radians([key.yaw for key in BODY_KEYS]))(at)
    for side in ("left", "right"):
        pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = _hands(at, times, side, rng)
    pose[:, 23:25] = _gaze(at, rng, 8.0)
    walk = np.zeros((frames, 3))
    walk[:, 0], walk[:, 2] = 0.05 * np.sin(0.31 * at + rng.uniform(0, 6)), 0.06 * np.sin(0.23 * at + rng.uniform(0, 6))
    expression = 0.8 * _face_track(at, rng)
    frame = [clamp(Signals.from_full_pose(p, translation=t, expression=e)) for p, t, e in zip(pose, walk, expression)]
    full = np.stack([signals.full_pose() for signals in frame])
    standing = grounded(full, np.stack([signals.translation for signals in frame]), "each")
    placed = tuple(signals.replace(translation=t) for signals, t in zip(frame, standing))
    return SignalSequence(placed, _rate(at), f"casual body {seed}")


def face_motion(frames: int, seed: int) -> SignalSequence:
    """`frames` face frames: named expressions and their mixtures, then speech; the head turns a little, the eyes look about."""
    rng = np.random.default_rng([seed, 2])
    expressions, speech = len(EXPRESSIONS) * 4, len(SENTENCE)
    at = _sampled(np.arange(expressions + speech) * FACE_KEY, frames)
    pose = np.zeros((frames, 55, 3))
    pose[:, 1:22] = named_pose("stand")
    wander = _waves(at, rng, 6, (0.35, 0.9))
    for joint, row, degrees in (("neck", 0, 4), ("head", 0, 6)):
        scale = np.radians([degrees, 1.5 * degrees, 0.7 * degrees])
        pose[:, JOINT_NAMES.index(joint)] += scale * wander[:, row : row + 3]
    pose[:, JOINT_NAMES.index("spine3")] += np.radians(1.5) * wander[:, 3:]
    pose[:, 23:25] = _gaze(at, rng, 14.0)
    for side in ("left", "right"):
        pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = named_hand("relaxed", side)
    expression = _face_track(at, rng)
    frame = tuple(clamp(Signals.from_full_pose(p, expression=e)) for p, e in zip(pose, expression))
    return SignalSequence(frame, _rate(at), f"face {seed}")


def turning(motion: SignalSequence, degrees: float) -> SignalSequence:
    """`motion` of somebody who also turns about the vertical, `degrees` to either side, twice in all."""
    angle = np.radians(degrees) * np.sin(4 * np.pi * (np.arange(len(motion)) + 0.5) / len(motion))
    turns = angle[:, None] * np.array([0.0, 1.0, 0.0])
    frames = tuple(
        signals.replace(
            global_orient=(Rotation.from_rotvec(turn) * Rotation.from_rotvec(signals.global_orient.copy())).as_rotvec()
        )
        for signals, turn in zip(motion, turns)
    )
    return SignalSequence(frames, motion.fps, motion.name)


def _sampled(times: np.ndarray, frames: int) -> np.ndarray:
    """(t,) seconds, evenly from the first key to the last."""
    return np.linspace(times[0], times[-1], frames) if frames > 1 else times[:1].copy()


def _rate(at: np.ndarray) -> float:
    return float(1 / (at[1] - at[0])) if len(at) > 1 else 30.0


def _body_pose(key: BodyKey, amplitude: float, girth: float) -> np.ndarray:
    """(21, 3): the library pose with the key's joints, the latter scaled about the standing pose."""
    own = {"stand": _DOWN, "hands_on_hips": _HIPS}
    pose = turned(np.zeros((21, 3)), own[key.pose]) if key.pose in own else named_pose(key.pose)
    pose = np.asarray(pose + amplitude * (turned(pose, key.joints) - pose))
    if key.pose == "hands_on_hips":
        for joint, side in (("left_shoulder", 1), ("right_shoulder", -1)):
            pose[BODY_JOINTS.index(joint), 2] += side * np.radians(girth)
    return pose


def _waves(at: np.ndarray, rng: np.random.Generator, count: int, band: tuple[float, float]) -> np.ndarray:
    """(t, count) slow signals in about [−1, 1]: two sines each, of `band` radians per second."""
    rate, phase = rng.uniform(*band, (2, count)), rng.uniform(0, 2 * np.pi, (2, count))
    slow, fast = (np.sin(at[:, None] * factor * rate[k] + phase[k]) for k, factor in enumerate((1, 1.9)))
    return np.asarray(0.6 * slow + 0.4 * fast)


def _sway(at: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(t, 21, 3) small turns of trunk, head and wrists that never stop."""
    degrees = {"spine1": 1.5, "spine2": 1.5, "spine3": 1.5, "neck": 3, "head": 4, "left_shoulder": 2, "right_shoulder": 2,
               "left_wrist": 5, "right_wrist": 5}  # fmt: skip
    sway = np.zeros((len(at), 21, 3))
    for joint, size in degrees.items():
        sway[:, BODY_JOINTS.index(joint)] = np.radians(size) * _waves(at, rng, 3, (0.5, 1.4))
    return sway


def _hands(at: np.ndarray, times: np.ndarray, side: str, rng: np.random.Generator) -> np.ndarray:
    """(t, 15, 3): a hand pose at every body key, all of `HANDS` in turn."""
    names = [*HANDS, "relaxed", "thumbs_up", "relaxed"]
    order = [names[k] for _ in range(len(times) // len(names) + 1) for k in rng.permutation(len(names))]
    chosen = [key.hands or name for key, name in zip(BODY_KEYS, order)]
    return np.asarray(PchipInterpolator(times, np.stack([named_hand(name, side) for name in chosen]))(at))


def _gaze(at: np.ndarray, rng: np.random.Generator, degrees: float) -> np.ndarray:
    """(t, 2, 3) rotations of both eyes together."""
    look = _waves(at, rng, 2, (0.8, 2.0)) * np.radians([0.6 * degrees, degrees])
    return np.repeat(np.insert(look, 2, 0, axis=1)[:, None], 2, axis=1)


def _expression(name: str) -> np.ndarray:
    """ψ (52,) of one of `EXPRESSIONS`."""
    return coefficients(_EXPRESSIONS[name]) if name in _EXPRESSIONS else named_expression(name)


def _face_track(at: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(t, 52): expressions with mixtures of two, speech, blinks; repeated as long as `at` lasts."""
    keys = [np.zeros(52)]
    while len(keys) * FACE_KEY <= at[-1] + FACE_KEY:
        for name in EXPRESSIONS:
            value = _expression(name) * rng.uniform(0.75, 1.0)
            other = _expression(EXPRESSIONS[rng.integers(len(EXPRESSIONS))])
            mixed = np.maximum(value, rng.uniform(0.2, 0.5) * other)
            keys += [0.6 * value, value, mixed, 0.4 * mixed]
        smile = rng.uniform(0, 0.4) * named_expression("smile")
        keys += [
            np.maximum(rng.uniform(0.8, 1.1) * coefficients(VISEMES[name]), smile * (name not in ("oo", "oh")))
            for name in SENTENCE
        ]
    track = PchipInterpolator(np.arange(len(keys)) * FACE_KEY, np.stack(keys))(at)
    for side in ("Left", "Right"):
        lid = EXPRESSION_NAMES.index(f"eyeBlink{side}")
        track[:, lid] = np.maximum(track[:, lid], np.clip(1.3 - np.abs((at + 0.9) % 3.1 - 0.2) / 0.12, 0, 1))
    brow = _waves(at, rng, 3, (0.5, 1.5))
    for name, column in (("browInnerUp", 0), ("browOuterUpLeft", 1), ("browOuterUpRight", 2)):
        row = EXPRESSION_NAMES.index(name)
        track[:, row] = np.maximum(track[:, row], 0.3 * brow[:, column])
    return np.asarray(np.clip(track, 0, 1))
