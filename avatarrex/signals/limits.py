"""Joint limits of the default person: soft bounds per joint and axis, and random signals within them.

Axes are the T-pose's: +X the person's left, +Y up, +Z forward; radians. The right side mirrors the left (y and z negated).
"""

from __future__ import annotations

import numpy as np

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES

_DEGREES: dict[str, tuple[tuple[int, int], ...]] = {
    "hip": ((-115, 25), (-35, 35), (-15, 40)),
    "knee": ((-8, 140), (-8, 8), (-5, 5)),
    "ankle": ((-28, 40), (-15, 15), (-15, 15)),
    "foot": ((-35, 30), (-5, 5), (-5, 5)),
    "collar": ((-10, 10), (-22, 18), (-12, 22)),
    "shoulder": ((-60, 50), (-90, 30), (-85, 75)),
    "elbow": ((-75, 75), (-148, 5), (-10, 10)),
    "wrist": ((-15, 15), (-25, 25), (-60, 60)),
    "thumb1": ((-30, 30), (-30, 50), (-40, 28)),
    "eye": ((-25, 25), (-30, 30), (0, 0)),
}
_MIDDLE = {
    "spine1": ((-15, 30), (-20, 20), (-15, 15)),
    "spine2": ((-10, 20), (-15, 15), (-12, 12)),
    "spine3": ((-10, 15), (-15, 15), (-10, 10)),
    "neck": ((-25, 25), (-35, 35), (-20, 20)),
    "head": ((-25, 25), (-35, 35), (-20, 20)),
    "jaw": ((0, 20), (-5, 5), (0, 0)),
}
FLEXION = {
    "index": (0.17, 0.21, -0.96), "middle": (-0.14, 0.06, -0.99), "ring": (-0.34, 0.07, -0.94), "pinky": (-0.43, -0.09, -0.90),
    "thumb": (0.53, 0.84, -0.02),
}  # fmt: skip
"""Axes about which fingers close, from bone and nail directions of the default person (nail × bone)."""
_CLOSE = {"1": (-15, 95), "2": (-5, 105), "3": (-10, 80), "thumb2": (-10, 50), "thumb3": (-12, 75)}
_SPREAD = {"index": 15, "middle": 8, "ring": 10, "pinky": 18}
"""Degrees about y of the first knuckles, either way."""


def joint_limits() -> np.ndarray:
    """(55, 3, 2) lowest and highest rotation vector components."""
    limits = np.zeros((55, 3, 2))
    for j, name in enumerate(JOINT_NAMES):
        side, _, part = name.partition("_")
        if name in _MIDDLE:
            limits[j] = _MIDDLE[name]
        elif side in ("left", "right"):
            left = _left(part)
            limits[j] = left if side == "left" else [left[0], (-left[1][1], -left[1][0]), (-left[2][1], -left[2][0])]
    return np.radians(limits)


def _left(part: str) -> tuple[tuple[int, int], ...]:
    """Degrees of a left-side joint."""
    if part in _DEGREES:
        return _DEGREES[part]
    finger, knuckle = part[:-1], part[-1]
    low, high = _CLOSE[part if finger == "thumb" else knuckle]
    spread = _SPREAD[finger] if knuckle == "1" else 0
    box = []
    for axis, extra in zip(FLEXION[finger], (0, spread, 0)):
        ends = sorted((axis * low, axis * high))
        # 2: named poses are given in whole degrees
        box.append((round(ends[0]) - 2 - extra, round(ends[1]) + 2 + extra))
    return tuple(box)


LIMITS = joint_limits()


def clamp(signals: Signals) -> Signals:
    """The nearest signals within the joint limits (the root is free; coefficients 0 to 1)."""
    pose = signals.full_pose()
    pose[1:] = np.clip(pose[1:], LIMITS[1:, :, 0], LIMITS[1:, :, 1])
    expression = np.clip(signals.expression, 0, 1)
    return Signals.from_full_pose(pose, translation=signals.translation, expression=expression, shape=signals.shape)


def violations(signals: Signals) -> tuple[str, ...]:
    """Names of the joints that are outside their limits."""
    pose = signals.full_pose()
    beyond = (pose < LIMITS[:, :, 0] - 1e-9) | (pose > LIMITS[:, :, 1] + 1e-9)
    return tuple(name for name, bad in zip(JOINT_NAMES[1:], beyond[1:]) if np.any(bad))


def random_signals(rng: np.random.Generator, scale: float = 0.5) -> Signals:
    """Uniform within `scale` times the joint limits; sparse expression; root at rest."""
    low, high = scale * LIMITS[..., 0], scale * LIMITS[..., 1]
    pose = rng.uniform(low, high)
    pose[0] = 0
    expression = rng.random(52) * (rng.random(52) < 0.15) * scale
    return Signals.from_full_pose(pose, expression=expression)
