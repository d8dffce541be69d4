"""Edits of a driving signal by the names a person uses: one joint, one coefficient, a group.

Joint names are those of `avatarrex.signals.joints`; rotation vectors in radians. Everything returns a new `Signals`.
Letters: n the 230 numbers of a signal.
"""

from __future__ import annotations

import re

import numpy as np
from avatarrex_studio.session.state import Vector, vector
from jaxtyping import Float64

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import (
    BODY_GROUPS,
    BODY_JOINTS,
    EXPRESSION_NAMES,
    FACE_REGIONS,
    HAND_JOINTS,
    JOINT_NAMES,
)
from avatarrex.signals.limits import LIMITS, clamp
from avatarrex.templates.parts import HANDS

SLOTS: dict[str, slice] = {
    **{name: slice(3 * k, 3 * k + 3) for k, name in enumerate(JOINT_NAMES)},
    **{name: slice(k, k + 1) for k, name in enumerate(EXPRESSION_NAMES, 165)},
    "translation": slice(217, 220),
    "shape": slice(220, 230),
}
"""Where the numbers of each joint and coefficient, of the place and of the shape are in `numbers`."""
FACE_GROUPS: dict[str, tuple[str, ...]] = {
    group: tuple(name for name in EXPRESSION_NAMES if name.startswith(group)) for group in FACE_REGIONS
}
"""The 52 coefficients by region."""
FACE_JOINTS = ("jaw", "left_eye", "right_eye")
GROUPS: dict[str, tuple[str, ...]] = {
    **BODY_GROUPS,
    "body": BODY_JOINTS,
    **{hand: tuple(hand.replace("hand", joint) for joint in HAND_JOINTS) for hand in HANDS},
    "face": (*FACE_JOINTS, *EXPRESSION_NAMES),
    "face joints": FACE_JOINTS,
    **FACE_GROUPS,
    "root": ("pelvis", "translation"),
    "shape": ("shape",),
    "all": tuple(SLOTS),
}
"""What can be reset together."""

SHAPE_RANGE = 2.5
"""Standard deviations of each direction, either way, that were looked at with the packaged avatar; a print on a shirt tears a little at 3."""


def joint_index(name: str) -> int:
    """Row of `Signals.full_pose`. Raises `InputError` for an unknown joint."""
    if name not in JOINT_NAMES:
        raise InputError("joint", "", "one of the 55 SMPL-X joints", name)
    return JOINT_NAMES.index(name)


def joint(signals: Signals, name: str) -> Vector:
    """Rotation vector of a joint."""
    return vector(signals.full_pose()[joint_index(name)])


def set_joint(signals: Signals, name: str, rotation: Vector, limited: bool = False) -> Signals:
    """One joint's rotation vector; kept within its limits when `limited` (the root has none)."""
    row, value = joint_index(name), np.asarray(rotation, dtype=np.float64)
    return _with(signals, {name: np.clip(value, *LIMITS[row].T) if limited and row else value})


def set_expression(signals: Signals, name: str, value: float) -> Signals:
    """One expression coefficient. Raises `InputError` for an unknown name."""
    if name not in EXPRESSION_NAMES:
        raise InputError("expression", "", "one of the 52 coefficients, e.g. jawOpen", name)
    return _with(signals, {name: value})


def reset(signals: Signals, group: str) -> Signals:
    """A single joint or coefficient, or else one of `GROUPS`, at rest again. Raises `InputError` for another name."""
    names = entries(group)
    if not set(names) <= set(SLOTS):
        raise InputError("reset", "", "a group, a joint or a coefficient", group)
    return _with(signals, dict.fromkeys(names, 0.0))


def copy_group(signals: Signals, source: Signals, group: str) -> Signals:
    """`signals` with the joints and coefficients of `group` taken from `source`. Raises `InputError`."""
    if group not in GROUPS:
        raise InputError("group", "", "one of " + ", ".join(GROUPS), group)
    values = numbers(source)
    return _with(signals, {name: values[SLOTS[name]] for name in GROUPS[group] if name not in ("translation", "shape")})


def counterpart(name: str) -> str:
    """The joint or coefficient on the other side; itself in the middle."""
    swap = {"left": "right", "right": "left", "Left": "Right", "Right": "Left"}
    other = re.sub("^(left|right)(?=_)|(?<=[a-z])(Left|Right)$", lambda side: swap[side[0]], name)
    return other if other in SLOTS and other not in ("jawLeft", "jawRight", "mouthLeft", "mouthRight") else name


def limited(signals: Signals, parts: tuple[str, ...]) -> Signals:
    """`signals` with some of its fields within the joint limits."""
    within = clamp(signals)
    return signals.replace(**{part: getattr(within, part) for part in parts})


def scaled(signals: Signals, group: str, factor: float) -> Signals:
    """The joints and coefficients of one of `GROUPS` times `factor`, coefficients to 1 at most. Raises `InputError` for another name."""
    if group not in GROUPS:
        raise InputError("group", "", "one of " + ", ".join(GROUPS), group)
    values = numbers(signals)
    most = {name: 1.0 if name in EXPRESSION_NAMES else np.inf for name in GROUPS[group]}
    return _with(signals, {name: np.minimum(factor * values[SLOTS[name]], most[name]) for name in GROUPS[group]})


def changed(signals: Signals, name: str) -> bool:
    """Whether a joint, a coefficient, or else anything of a group is away from rest."""
    values = numbers(signals)
    return any(values[SLOTS[entry]].any() for entry in entries(name))


def entries(name: str) -> tuple[str, ...]:
    """What a name stands for; the joints `jaw` and `head` go before the groups that are called so."""
    return (name,) if name in SLOTS else GROUPS.get(name, (name,))


def numbers(signals: Signals) -> Float64[np.ndarray, " n"]:
    """All numbers of a signal, in the order of `SLOTS`."""
    return np.concatenate([signals.full_pose().ravel(), signals.expression, signals.translation, signals.shape])


def of_numbers(values: Float64[np.ndarray, " n"]) -> Signals:
    """The signal that `numbers` came from, validated."""
    pose, expression, translation, shape = np.split(values, (165, 217, 220))
    return Signals.from_full_pose(pose.reshape(55, 3), expression=expression, translation=translation, shape=shape)


def differing(before: Signals, after: Signals) -> tuple[str, ...]:
    """Names of `SLOTS` whose numbers differ."""
    differ = numbers(before) != numbers(after)
    return tuple(name for name, slot in SLOTS.items() if differ[slot].any())


def _with(signals: Signals, changes: dict[str, np.ndarray | float]) -> Signals:
    """`signals` with the numbers of some names replaced."""
    values = numbers(signals)
    for name, value in changes.items():
        values[SLOTS[name]] = value
    return of_numbers(values)
