"""The driving signals that a surface is fitted to: poses people take, and others inside the joint limits."""

from __future__ import annotations

import numpy as np

from avatarrex.capture.synthetic.motions import body_motion
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import BODY_GROUPS, EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.limits import clamp, random_signals

RANDOM_SHARE, EXTREME_SHARE = 0.25, 0.35
"""Of the poses: all joints at random inside the limits; a pose that people take with one limb far out."""
RANDOM_SCALE, EXTREME_SCALE = 0.45, 0.95
"""Of the limits: beyond half of all of them at once limbs pass through each other."""
SWAY = 0.08
"""Radians of noise on every joint of a pose that people take."""
LIMBS = tuple(tuple(map(JOINT_NAMES.index, names)) for names in BODY_GROUPS.values())


def fitting_poses(count: int, seed: int = 0) -> list[Signals]:
    """`count` signals with neutral faces, in random order: bodies and hands move together."""
    rng = np.random.default_rng(seed)
    drawn, extreme = round(RANDOM_SHARE * count), round(EXTREME_SHARE * count)
    natural = [_swayed(signals, rng) for signals in body_motion(count - drawn, seed)]
    order = rng.permutation(len(natural))
    poses = [natural[index] for index in order[extreme:]]
    poses += [_one_limb_out(natural[index], rng) for index in order[:extreme]]
    poses += [random_signals(rng, RANDOM_SCALE) for _ in range(drawn)]
    return [_at_rest(poses[index]) for index in rng.permutation(count)]


def single_expressions() -> list[Signals]:
    """Each of the 52 expressions alone, at 1."""
    return [Signals.rest().replace(expression=row) for row in np.eye(len(EXPRESSION_NAMES))]


def _swayed(signals: Signals, rng: np.random.Generator) -> Signals:
    pose = signals.full_pose()
    pose[1:22] += SWAY * rng.normal(size=(21, 3))
    return clamp(Signals.from_full_pose(pose))


def _one_limb_out(signals: Signals, rng: np.random.Generator) -> Signals:
    pose, limb = signals.full_pose(), list(LIMBS[rng.integers(len(LIMBS))])
    pose[limb] = random_signals(rng, EXTREME_SCALE).full_pose()[limb]
    return Signals.from_full_pose(pose)


def _at_rest(signals: Signals) -> Signals:
    """The same body and hands; no expression, no place in the world."""
    pose = signals.full_pose()
    pose[0] = 0
    return Signals.from_full_pose(pose)
