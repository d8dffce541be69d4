"""Macros: one slider over several joints or coefficients, which shows what the present state has along it.

A finger's `curl` and `spread` are directions d in the 9 numbers of its three joints. Their values are v = D⁺ x, D⁺ the
pseudo-inverse of both, and a set value adds (v' − v) d: the other macro keeps its value, and whatever the macros do not reach stays.
A face macro is a direction d ≥ 0 in the 52 coefficients with v = ψ·d / d·d; a set value is clip(ψ + t d, 0, 1) with the t
that gives exactly v'. Radians; right hands mirror left ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from jaxtyping import Float64

from avatarrex.errors import InputError
from avatarrex.signals.joints import FINGERS, HAND_JOINTS
from avatarrex.signals.library import coefficients
from avatarrex.signals.limits import FLEXION

CLOSED = {**dict.fromkeys(FINGERS, (85.0, 95.0, 60.0)), "thumb": (24.0, 45.0, 60.0)}
"""Degrees of knuckle, middle and tip at a curl of 1."""
APART = {"index": -14.0, "middle": -3.0, "ring": 8.0, "pinky": 17.0, "thumb": -25.0}
"""Degrees of the left first knuckles about y at a spread of 1."""
HAND_MACROS = ("curl", "spread")
CURL, SPREAD = (-0.2, 1.0), (-1.0, 1.0)
"""Ranges of the sliders."""
_MIRROR = np.array([1.0, -1.0, -1.0])
FACE_MACROS: dict[str, dict[str, dict[str, float]]] = {
    "expression": {
        "smile": {"mouthSmile*": 1.0, "cheekSquint*": 0.45, "eyeSquint*": 0.2},
        "frown": {"mouthFrown*": 1.0, "mouthShrugLower": 0.4},
        "surprise": {"eyeWide*": 1.0, "browInnerUp": 0.9, "browOuterUp*": 0.9, "jawOpen": 0.5},
        "anger": {"browDown*": 1.0, "noseSneer*": 0.6, "eyeSquint*": 0.4, "mouthPress*": 0.5},
        "worry": {"browInnerUp": 1.0, "mouthStretch*": 0.4},
    },
    "brows": {
        "brows up": {"browInnerUp": 1.0, "browOuterUp*": 1.0},
        "brows down": {"browDown*": 1.0},
    },
    "eyes": {
        "blink": {"eyeBlink*": 1.0},
        "wide eyes": {"eyeWide*": 1.0},
        "squint": {"eyeSquint*": 1.0, "cheekSquint*": 0.5},
        "look left": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
        "look right": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
        "look up": {"eyeLookUp*": 1.0},
        "look down": {"eyeLookDown*": 1.0},
    },
    "visemes": {
        "ah": {"jawOpen": 0.7, "mouthLowerDown*": 0.25, "mouthUpperUp*": 0.15},
        "ee": {"mouthStretch*": 0.6, "mouthSmile*": 0.35, "jawOpen": 0.15, "mouthLowerDown*": 0.3},
        "eh": {"jawOpen": 0.35, "mouthStretch*": 0.4, "mouthLowerDown*": 0.2},
        "oh": {"mouthFunnel": 0.7, "jawOpen": 0.4},
        "oo": {"mouthPucker": 0.9, "mouthFunnel": 0.35, "jawOpen": 0.08},
        "m b p": {"mouthClose": 0.15, "mouthPress*": 0.8, "mouthRollLower": 0.4, "mouthRollUpper": 0.4},
        "f v": {"mouthRollLower": 0.8, "mouthUpperUp*": 0.3, "jawOpen": 0.05},
        "l th": {"jawOpen": 0.25, "tongueOut": 0.3},
        "s sh": {"mouthFunnel": 0.3, "mouthStretch*": 0.3, "mouthLowerDown*": 0.25, "jawOpen": 0.08},
    },
}
"""Face macros by group; `…*` is the left coefficient and the right."""


def hand_values(pose: Float64[np.ndarray, "15 3"], side: str) -> dict[tuple[str, str], float]:
    """What a hand's pose has along each (finger, `curl` or `spread`)."""
    found = {}
    for finger in FINGERS:
        values = _inverse(finger, side) @ pose[_rows(finger)].ravel()
        found.update({(finger, macro): float(value) for macro, value in zip(HAND_MACROS, values)})
    return found


def set_hand(
    pose: Float64[np.ndarray, "15 3"], side: str, fingers: tuple[str, ...], macro: str, value: float
) -> Float64[np.ndarray, "15 3"]:
    """`pose` with one macro of some fingers set; several move together, their mean becomes `value`. Raises `InputError`."""
    if side not in ("left", "right"):
        raise InputError("hand", "", "left or right", side)
    if macro not in HAND_MACROS or not fingers or not set(fingers) <= set(FINGERS):
        raise InputError(
            "hand macro", "", "curl or spread of " + ", ".join(FINGERS), f"{macro} of {', '.join(fingers)}"
        )
    now = hand_values(pose, side)
    step = value - hand_mean(now, fingers, macro)
    changed = pose.copy()
    for finger in fingers:
        changed[_rows(finger)] += step * _directions(finger, side)[HAND_MACROS.index(macro)].reshape(3, 3)
    return changed


def hand_mean(values: Mapping[tuple[str, str], float], fingers: tuple[str, ...], macro: str) -> float:
    """The mean of a macro over some fingers."""
    return sum(values[finger, macro] for finger in fingers) / len(fingers)


def face_value(expression: Float64[np.ndarray, " 52"], macro: str) -> float:
    """What ψ has along a face macro: 0 none, 1 all of it. Raises `InputError` for an unknown one."""
    direction = face_direction(macro)
    return float(expression @ direction / (direction @ direction))


def set_face(expression: Float64[np.ndarray, " 52"], macro: str, value: float) -> Float64[np.ndarray, " 52"]:
    """ψ with a face macro at `value`, its coefficients within 0 and 1; others stay. Raises `InputError`."""
    direction = face_direction(macro)
    used = direction > 0
    low, high = -1 / direction[used].min(), 1 / direction[used].min()  # there all are 0, or 1

    def moved(t: float) -> Float64[np.ndarray, " 52"]:
        changed = expression.copy()
        changed[used] = np.clip(expression[used], 0, 1) + t * direction[used]
        changed[used] = np.clip(changed[used], 0, 1)
        return changed

    wanted = float(np.clip(value, 0, 1))
    for _ in range(60):  # monotone in t
        middle = (low + high) / 2
        low, high = (middle, high) if face_value(moved(middle), macro) < wanted else (low, middle)
    return moved(high)


def face_direction(macro: str) -> Float64[np.ndarray, " 52"]:
    """d of a face macro. Raises `InputError` with all names for an unknown one."""
    for group in FACE_MACROS.values():
        if macro in group:
            return coefficients(group[macro])
    raise InputError(
        "face macro", "", "one of " + ", ".join(name for group in FACE_MACROS.values() for name in group), macro
    )


def _rows(finger: str) -> slice:
    first = HAND_JOINTS.index(f"{finger}1")
    return slice(first, first + 3)


@cache
def _directions(finger: str, side: str) -> Float64[np.ndarray, "2 9"]:
    """curl and spread."""
    curl = np.radians(np.outer(CLOSED[finger], FLEXION[finger]))
    spread = np.zeros((3, 3))
    spread[0, 1] = np.radians(APART[finger])
    mirror = _MIRROR if side == "right" else 1.0
    return np.stack([(curl * mirror).ravel(), (spread * mirror).ravel()])


@cache
def _inverse(finger: str, side: str) -> Float64[np.ndarray, "2 9"]:
    """D⁺."""
    return np.asarray(np.linalg.pinv(_directions(finger, side).T))
