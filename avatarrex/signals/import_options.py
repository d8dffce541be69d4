"""What a user may say about a motion file instead of what its reader guesses: one frozen value, JSON in and out.

An empty value leaves a guess to the reader. Axes are the file's own; what follows from them: world_axes.py.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.sequence import check_rate

AXES = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
UNITS = {"metres": 1.0, "decimetres": 0.1, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254, "feet": 0.3048,
         "CMU units of 1/0.45 inch": 0.0254 / 0.45}  # fmt: skip
"""Metres."""
SHORT = {"m": "metres", "dm": "decimetres", "cm": "centimetres", "mm": "millimetres", "in": "inches", "ft": "feet"}
RESTS = ("pose", "bones")
"""The rest pose is a person's (T, A, arms down), or a bundle of bones that tells no more than their directions."""
FLOORS = ("contacts", "each", "lowest", "file")
"""What is put on the floor: feet that stand, every frame, the lowest frame, nothing (heights as in the file)."""
SIDES = ("left", "right")
MOST_JOINTS = 200
"""Entries of a joint map."""


@dataclass(frozen=True)
class ImportOptions:
    """Choices for `import_motion`; `ImportOptions()` guesses everything. Raises `InputError` for what cannot be."""

    up: str = ""
    """One of `AXES`."""
    forward: str = ""
    """The axis of the file that looks at the camera; else the person does, in the first frame."""
    unit: str = ""
    """A name of `UNITS` or `SHORT`, or metres as a number; else the path is scaled by the length of the leg."""
    fps: float | None = None
    """Frames a second."""
    joints: tuple[tuple[str, str], ...] = ()
    """Pairs of one of our joints and the name of the file's; an empty name leaves ours at rest."""
    rest: str = ""
    """One of `RESTS`."""
    floor: str = ""
    """One of `FLOORS`."""
    lock_feet: bool = False
    """Whether feet that stand are kept where they stand."""
    side: str = ""
    """Which hand a file of one hand has: one of `SIDES`."""
    hand_mean: str = ""
    """`flat`, or the model file whose mean hand and components the file's fingers are given by."""
    expressions: str = ""
    """A file with the 52 coefficients of each coefficient of another face (expression_map.py)."""

    def __post_init__(self) -> None:
        for name, allowed in (("up", AXES), ("forward", AXES), ("rest", RESTS), ("floor", FLOORS), ("side", SIDES)):
            _check(getattr(self, name) in ("", *allowed), name, "one of " + ", ".join(allowed), getattr(self, name))
        across = not (self.up and self.forward) or self.up[1] != self.forward[1]
        _check(across, "forward", f"an axis across up ({self.up})", self.forward)
        self.metres  # noqa: B018  refuses a unit that is none
        if self.fps is not None:
            check_rate(self.fps, "motion options")
        _check(len(self.joints) <= MOST_JOINTS, "joints", f"at most {MOST_JOINTS} joints", len(self.joints))
        for pair in self.joints:
            _check(pair[0] in JOINT_NAMES, "joints", "one of " + ", ".join(JOINT_NAMES[:25]) + " …", pair[0])

    @property
    def metres(self) -> float | None:
        """Metres of the unit that was named; None without one."""
        if not self.unit:
            return None
        name = SHORT.get(self.unit, self.unit)
        try:
            value = UNITS[name] if name in UNITS else float(name)
        except ValueError:
            value = math.nan
        _check(1e-6 <= value <= 1e3, "unit", ", ".join((*SHORT, "or metres as a number")), self.unit)
        return value

    def to_json(self) -> dict[str, Any]:
        """Plain values; what is guessed is left out."""
        default = ImportOptions()
        kept = {name: value for name, value in asdict(self).items() if value != getattr(default, name)}
        return {**kept, "joints": dict(self.joints)} if self.joints else kept

    @classmethod
    def from_json(cls, data: Any, source: str = "motion options") -> ImportOptions:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict):
            raise InputError(source, "", "an object", type(data).__name__)
        names = tuple(item.name for item in fields(cls))
        for name in data:
            if name not in names:
                raise InputError(source, str(name), "one of " + ", ".join(names), "an unknown field")
        joints = data.get("joints", {})
        if not isinstance(joints, dict):
            raise InputError(source, "joints", "an object of our joint's name and the file's", type(joints).__name__)
        for name, kind, words in (*((name, str, "a text") for name in names[:3]), ("rest", str, "a text"), ("floor", str, "a text"),
                                  ("side", str, "a text"), ("hand_mean", str, "a text"), ("expressions", str, "a text"),
                                  ("lock_feet", bool, "true or false"), ("fps", int | float | None, "a number")):  # fmt: skip
            if name in data and (not isinstance(data[name], kind) or (name == "fps" and isinstance(data[name], bool))):
                raise InputError(source, name, words, data[name])
        if not all(isinstance(value, str) for value in joints.values()):
            raise InputError(source, "joints", "names of joints", "other values")
        return cls(**{**data, "joints": tuple(joints.items())})


def axis(name: str) -> tuple[float, float, float]:
    """The unit vector of one of `AXES`."""
    sign = -1.0 if name[0] == "-" else 1.0
    x, y, z = (sign * (letter == name[1]) for letter in "XYZ")
    return x, y, z


def _check(ok: bool, field: str, expected: str, found: object) -> None:
    if not ok:
        raise InputError("motion options", field, expected, found)
