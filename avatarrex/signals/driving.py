"""Driving signals s = (θ body, φ hands, ψ face), with the root's placement and the body's shape (paper sec. 3, notation).

Rotation vectors in radians in the joints' rest frames (axes of the T-pose), metres, coefficients. Immutable float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.json_text import parse_json
from avatarrex.signals.joints import JOINT_ROWS

SHAPES: dict[str, tuple[int, ...]] = {
    "global_orient": (3,),
    "translation": (3,),
    "body_pose": (21, 3),
    "jaw_pose": (3,),
    "eye_pose": (2, 3),
    "left_hand_pose": (15, 3),
    "right_hand_pose": (15, 3),
    "expression": (52,),
    "shape": (10,),
}
ROTATIONS = ("global_orient", "body_pose", "jaw_pose", "eye_pose", "left_hand_pose", "right_hand_pose")
"""The rotation vectors, in SMPL-X order."""
LARGEST = {
    **dict.fromkeys(SHAPES, 1e3), "translation": 1e6, "expression": 5.0, "shape": 10.0
}  # fmt: skip
"""Largest magnitudes: 160 turns (exact in single precision to 1e-4), 1000 km, and as far as faces and bodies stay finite:
one coefficient of 50 or a β of 100 is a person of many metres: its volume takes minutes and gigabytes."""


@dataclass(frozen=True, eq=False)
class Signals:
    """One frame of driving signals: rotation vectors in radians, metres, coefficients; immutable float64.

    Start from `Signals.rest()` and `replace` fields, e.g. `body_pose=named_pose("wave")`. Raises `InputError` for another
    shape, for numbers that are not finite, and for magnitudes beyond `LARGEST`.
    """

    global_orient: np.ndarray
    translation: np.ndarray
    body_pose: np.ndarray
    """θ: the 21 body joints after the pelvis, SMPL-X order."""
    jaw_pose: np.ndarray
    eye_pose: np.ndarray
    """Left, right."""
    left_hand_pose: np.ndarray
    """φ: index, middle, pinky, ring, thumb × 3; zero is the flat hand."""
    right_hand_pose: np.ndarray
    expression: np.ndarray
    """ψ: 52 coefficients in Apple's order, 0 to 1."""
    shape: np.ndarray
    """β, standard deviations."""

    def __post_init__(self) -> None:
        for name in SHAPES:
            self._take(name, getattr(self, name))

    def _take(self, name: str, value: object) -> None:
        array = _array("signals", name, value)
        array.setflags(write=False)
        object.__setattr__(self, name, array)

    @classmethod
    def rest(cls) -> Signals:
        """T-pose, flat hands, neutral face, mean shape, at the origin."""
        return cls(**{name: np.zeros(shape) for name, shape in SHAPES.items()})

    @classmethod
    def from_full_pose(cls, pose: np.ndarray, **others: np.ndarray) -> Signals:
        """From (55, 3) rotation vectors in SMPL-X order and any other field by name."""
        pose = np.asarray(pose, dtype=np.float64)
        if pose.shape != (55, 3):
            raise InputError("signals", "full pose", "shape (55, 3)", pose.shape)
        parts = {name: pose[JOINT_ROWS[name]].reshape(SHAPES[name]) for name in ROTATIONS}
        return cls(**{name: np.zeros(shape) for name, shape in SHAPES.items()} | parts | others)

    def full_pose(self) -> np.ndarray:
        """(55, 3) rotation vectors in SMPL-X order."""
        return np.concatenate([getattr(self, name).reshape(-1, 3) for name in ROTATIONS])

    def replace(self, **changes: Any) -> Signals:
        """A copy with some fields changed, validated. Raises `TypeError` for a name that is none of them."""
        if not changes.keys() <= SHAPES.keys():
            raise TypeError(f"signals have no {', '.join(sorted(changes.keys() - SHAPES.keys()))}")
        made = object.__new__(Signals)
        for name in SHAPES:
            if name in changes:
                made._take(name, changes[name])
            else:  # read-only, and checked: it is shared
                object.__setattr__(made, name, getattr(self, name))
        return made

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Signals) and all(np.array_equal(getattr(self, n), getattr(other, n)) for n in SHAPES)

    def __hash__(self) -> int:
        return hash(tuple(getattr(self, name).tobytes() for name in SHAPES))

    def to_json(self) -> dict[str, Any]:
        """Plain lists by field name."""
        return {name: getattr(self, name).tolist() for name in SHAPES}

    @classmethod
    def from_json(cls, data: Any, source: str = "signals") -> Signals:
        """From `to_json`'s dictionary or its text; missing fields are at rest, unknown ones are refused."""
        if isinstance(data, str):
            data = parse_json(data, source)
        if not isinstance(data, dict):
            raise InputError(source, "", "an object", type(data).__name__)
        for name in data:
            if name not in SHAPES:
                raise InputError(source, name, "one of " + ", ".join(SHAPES), "an unknown field")
        return cls.rest().replace(**{name: _array(source, name, value) for name, value in data.items()})


def _array(source: str, name: str, value: object) -> np.ndarray:
    """A float64 copy of `value`, checked: numbers, shape, finite, within `LARGEST`."""
    try:
        given = np.array(value)
    except ValueError:  # ragged lists
        given = np.array(None)
    if given.dtype.kind not in "fiu":
        raise InputError(source, name, f"numbers of shape {SHAPES[name]}", repr(value)[:60])
    if given.shape != SHAPES[name]:
        raise InputError(source, name, f"shape {SHAPES[name]}", given.shape)
    array = given.astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(source, name, "finite numbers", "NaN or Inf")
    largest = float(np.abs(array).max())
    if largest > LARGEST[name]:
        raise InputError(source, name, f"numbers up to ±{LARGEST[name]:g}", f"{largest:g}")
    return array
