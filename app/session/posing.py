"""Edits of a driving signal by the names a person uses: one joint, one coefficient, a group.

Joint names are those of `avatarrex.signals.joints`; rotation vectors in radians. Everything returns a new `Signals`.
"""

from __future__ import annotations

import numpy as np
from avatarrex_studio.session.state import Vector, vector

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import BODY_GROUPS, BODY_JOINTS, EXPRESSION_NAMES, HAND_JOINTS, JOINT_NAMES
from avatarrex.signals.limits import LIMITS

FACE_GROUPS: dict[str, tuple[str, ...]] = {
    group: tuple(name for name in EXPRESSION_NAMES if name.startswith(group))
    for group in ("brow", "eye", "jaw", "mouth", "cheek", "nose", "tongue")
}
"""The 52 coefficients by region."""
GROUPS: dict[str, tuple[str, ...]] = {
    **BODY_GROUPS,
    "body": BODY_JOINTS,
    "left_hand": tuple(f"left_{name}" for name in HAND_JOINTS),
    "right_hand": tuple(f"right_{name}" for name in HAND_JOINTS),
    "face": ("jaw", "left_eye", "right_eye", *EXPRESSION_NAMES),
    "face joints": ("jaw", "left_eye", "right_eye"),
    **FACE_GROUPS,
    "root": ("pelvis", "translation"),
    "shape": ("shape",),
    "all": (*JOINT_NAMES, *EXPRESSION_NAMES, "translation", "shape"),
}
"""What can be reset together."""


def joint_index(name: str) -> int:
    """Row of `Signals.full_pose`. Raises `InputError` for an unknown joint."""
    if name not in JOINT_NAMES:
        raise InputError("joint", "", "one of the 55 SMPL-X joints", name)
    return JOINT_NAMES.index(name)


def with_pose(signals: Signals, pose: np.ndarray) -> Signals:
    """`signals` with all 55 rotation vectors replaced."""
    posed = Signals.from_full_pose(pose)
    return posed.replace(expression=signals.expression, shape=signals.shape, translation=signals.translation)


def joint(signals: Signals, name: str) -> Vector:
    """Rotation vector of a joint."""
    return vector(signals.full_pose()[joint_index(name)])


def set_joint(signals: Signals, name: str, rotation: Vector, limited: bool = False) -> Signals:
    """One joint's rotation vector; kept within its limits when `limited` (the root has none)."""
    pose, row = signals.full_pose(), joint_index(name)
    value = np.asarray(rotation, dtype=np.float64)
    pose[row] = np.clip(value, LIMITS[row, :, 0], LIMITS[row, :, 1]) if limited and row else value
    return with_pose(signals, pose)


def set_expression(signals: Signals, name: str, value: float) -> Signals:
    """One expression coefficient. Raises `InputError` for an unknown name."""
    if name not in EXPRESSION_NAMES:
        raise InputError("expression", "", "one of the 52 coefficients, e.g. jawOpen", name)
    expression = signals.expression.copy()
    expression[EXPRESSION_NAMES.index(name)] = value
    return signals.replace(expression=expression)


def reset(signals: Signals, group: str) -> Signals:
    """One of `GROUPS`, or a single joint or coefficient, at rest again. Raises `InputError` for another name."""
    names = GROUPS.get(group, (group,))
    if not set(names) <= set(GROUPS["all"]):
        raise InputError("reset", "", "a group, a joint or a coefficient", group)
    cleared = {name: np.zeros_like(getattr(signals, name)) for name in ("translation", "shape") if name in names}
    return _copied(signals, Signals.rest(), names).replace(**cleared)


def copy_group(signals: Signals, source: Signals, group: str) -> Signals:
    """`signals` with the joints and coefficients of `group` taken from `source`. Raises `InputError`."""
    if group not in GROUPS:
        raise InputError("group", "", "one of " + ", ".join(GROUPS), group)
    return _copied(signals, source, GROUPS[group])


def _copied(signals: Signals, source: Signals, names: tuple[str, ...]) -> Signals:
    joints = [JOINT_NAMES.index(name) for name in names if name in JOINT_NAMES]
    coefficients = [EXPRESSION_NAMES.index(name) for name in names if name in EXPRESSION_NAMES]
    pose, expression = signals.full_pose(), signals.expression.copy()
    pose[joints], expression[coefficients] = source.full_pose()[joints], source.expression[coefficients]
    return with_pose(signals, pose).replace(expression=expression)


def changed(signals: Signals, name: str) -> bool:
    """Whether a joint, a coefficient, or anything of a group is away from rest."""
    return any(_away(signals, entry) for entry in GROUPS.get(name, (name,)))


def _away(signals: Signals, name: str) -> bool:
    if name in JOINT_NAMES:
        return bool(signals.full_pose()[JOINT_NAMES.index(name)].any())
    if name in EXPRESSION_NAMES:
        return bool(signals.expression[EXPRESSION_NAMES.index(name)])
    return bool(getattr(signals, name).any())
