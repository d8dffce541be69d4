"""Who is put under stress, and driving signals that look for trouble: every family takes its turn, the rest is random.

The packaged avatar is loaded once for each process. Half turns, no turns, nearly both, opposed twists, hundreds of radians;
shapes of ±5 σ, expressions out of bounds, roots 1 km and 1000 km from the origin.
"""

from __future__ import annotations

import copy
from functools import cache

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.fields.body import BodyField
from avatarrex.measure.stress.case import Entry, Inputs
from avatarrex.signals.driving import LARGEST, SHAPES, Signals
from avatarrex.signals.limits import random_signals


@cache
def subject() -> Avatar:
    """The packaged avatar."""
    return load_avatar()


@cache
def double_body() -> BodyField:
    """Its body field in float64."""
    return copy.deepcopy(subject().body).double()


ENTRIES = {name: Entry(shape) for name, shape in SHAPES.items()}
SMPLX_JOINTS = 55
ALONG_X = (13, 14, 16, 17, 18, 19, 20, 21, *range(25, 55))
"""Joints with a bone along x in the T-pose: arms and fingers. All others: along y."""


def draw_signals(rng: np.random.Generator, number: int) -> Signals:
    """Signals of the family of that number."""
    pose = FAMILIES[number % len(FAMILIES)](rng)
    expression, shape = _expression(rng), _shape(rng)
    return Signals.from_full_pose(pose, expression=expression, shape=shape, translation=rng.normal(size=3) * _far(rng))


def inputs_of(signals: Signals) -> Inputs:
    """The signals as the inputs of a case."""
    return {name: np.array(getattr(signals, name)) for name in SHAPES}


def signals_of(inputs: Inputs) -> Signals:
    """Back again. Raises `InputError`."""
    return Signals(**{name: inputs[name] for name in SHAPES})


def directions(rng: np.random.Generator, count: int = SMPLX_JOINTS) -> np.ndarray:
    """Random unit vectors (count, 3)."""
    vector = rng.normal(size=(count, 3))
    return np.asarray(vector / np.linalg.norm(vector, axis=1, keepdims=True))


def _anything(rng: np.random.Generator) -> np.ndarray:
    return directions(rng) * rng.uniform(0, np.pi, (SMPLX_JOINTS, 1))


def _half_turns(rng: np.random.Generator) -> np.ndarray:
    """Exactly ±π about one of the axes."""
    pose = np.zeros((SMPLX_JOINTS, 3))
    pose[np.arange(SMPLX_JOINTS), rng.integers(3, size=SMPLX_JOINTS)] = rng.choice([-np.pi, np.pi], SMPLX_JOINTS)
    return pose


def _limits(rng: np.random.Generator) -> np.ndarray:
    """What a person can do, but for the root."""
    pose = random_signals(rng, 1.0).full_pose()
    pose[0] = rng.uniform(-3, 3, 3)
    return pose


def _nothing(rng: np.random.Generator) -> np.ndarray:
    """0, −0, subnormal numbers, and angles about the series' limits (0.1 in float32, 3e-3 in float64)."""
    angle = rng.choice(
        [0.0, -0.0, 1e-320, 1e-44, 1e-30, 1e-12, 1e-7, 3e-3, 3.2e-3, 0.0999999, 0.1000001], (SMPLX_JOINTS, 1)
    )
    return np.asarray(directions(rng) * angle)


def _nearly_half_turns(rng: np.random.Generator) -> np.ndarray:
    return (
        directions(rng)
        * np.pi
        * (1 + rng.choice([-1, 1], (SMPLX_JOINTS, 1)) * 10.0 ** rng.uniform(-16, -1, (SMPLX_JOINTS, 1)))
    )


def _twists(rng: np.random.Generator) -> np.ndarray:
    """170° to 180° about the bones, of a third of the joints: blended matrices lose a dimension."""
    pose = np.zeros((SMPLX_JOINTS, 3))
    axis = np.where(np.isin(np.arange(SMPLX_JOINTS), ALONG_X), 0, 1)
    turned = np.radians(rng.uniform(170, 180, SMPLX_JOINTS)) * rng.choice([-1, 1], SMPLX_JOINTS)
    exact = rng.random(SMPLX_JOINTS) < 0.2
    pose[np.arange(SMPLX_JOINTS), axis] = np.where(exact, np.pi, turned) * (rng.random(SMPLX_JOINTS) < 1 / 3)
    return pose


def _many_turns(rng: np.random.Generator) -> np.ndarray:
    return directions(rng) * LARGEST["body_pose"] * rng.uniform(0, 1, (SMPLX_JOINTS, 1))


FAMILIES = (_anything, _half_turns, _limits, _nothing, _nearly_half_turns, _twists, _many_turns)


def _expression(rng: np.random.Generator) -> np.ndarray:
    """Neutral, sparse, everything at once, or at the limits of what signals may have."""
    largest = LARGEST["expression"]
    which = rng.random()
    if which < 0.3:
        return np.zeros(52)
    if which < 0.7:
        return rng.random(52) * (rng.random(52) < 0.3)
    return np.ones(52) if which < 0.85 else rng.choice([-largest, largest], 52)


def _shape(rng: np.random.Generator) -> np.ndarray:
    which = rng.random()
    if which < 0.5:
        return np.zeros(10)
    return rng.uniform(-5, 5, 10) if which < 0.75 else rng.choice([-5.0, 5.0], 10)


def _far(rng: np.random.Generator) -> float:
    return float(rng.choice([0, 1, 1e3, 1e5], p=[0.4, 0.3, 0.25, 0.05]))
