"""The driving signals that a surface is fitted to: poses people take, and others inside the joint limits."""

from __future__ import annotations

import numpy as np

from avatarrex.capture.synthetic.motions import body_motion
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.limits import clamp, random_signals

RANDOM_SHARE = 0.4
"""Of the poses that are drawn inside the joint limits."""
RANDOM_SCALE = 0.45
"""Of the limits: beyond half of all of them at once limbs pass through each other."""
SWAY = 0.08
"""Radians of noise on every joint of a pose that people take."""


def fitting_poses(count: int, seed: int = 0) -> list[Signals]:
    """`count` signals with neutral faces: bodies and hands move together."""
    rng = np.random.default_rng(seed)
    drawn = round(RANDOM_SHARE * count)
    natural = body_motion(count - drawn, seed)
    poses = [_swayed(signals, rng) for signals in natural] + [random_signals(rng, RANDOM_SCALE) for _ in range(drawn)]
    order = rng.permutation(count)
    return [_neutral(poses[index]) for index in order]


def single_expressions() -> list[Signals]:
    """Each of the 52 expressions alone, at 1."""
    return [Signals.rest().replace(expression=row) for row in np.eye(len(EXPRESSION_NAMES))]


def _swayed(signals: Signals, rng: np.random.Generator) -> Signals:
    pose = signals.full_pose()
    pose[1:22] += SWAY * rng.normal(size=(21, 3))
    return clamp(Signals.from_full_pose(pose))


def _neutral(signals: Signals) -> Signals:
    return signals.replace(
        expression=np.zeros(52), jaw_pose=signals.jaw_pose, global_orient=np.zeros(3), translation=np.zeros(3), shape=np.zeros(10)
    )
