"""Corrections by the turns of near joints are found, and nothing is made of what is not there."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.distil.fit import Residuals, fit_correction
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals
from avatarrex.surface.pose_kernel import pose_kernel, turns
from avatarrex.surface.surface import Correction
from avatarrex.templates.person import load_person

ELBOW, KNEE = 18, 4
POSES, VERTICES = 300, 40


def predicted(mean: np.ndarray, correction: Correction, signals: list[Signals]) -> np.ndarray:
    """The equation of `Correction`, vertex by vertex."""
    turn, fitted = turned(signals), turns(correction.poses)
    out = np.repeat(mean[None].astype(float), len(signals), 0)
    for v, g in enumerate(correction.group):
        kernel = pose_kernel(turn, fitted, correction.joints[g], correction.closeness[g])
        value = np.clip(kernel @ correction.weights[g], correction.low[g], correction.high[g])
        out[:, v] += value @ correction.basis[v]
    return out


def turned(signals: list[Signals]) -> np.ndarray:
    return turns(np.stack([one.full_pose() for one in signals]))


@pytest.fixture
def signals() -> list[Signals]:
    rng = np.random.default_rng(0)
    return [random_signals(rng) for _ in range(POSES)]


def test_a_linear_correction_is_recovered_in_poses_that_were_not_fitted(signals):
    rng = np.random.default_rng(1)
    joint = np.where(np.arange(VERTICES) < VERTICES // 2, ELBOW, KNEE)
    true = rng.normal(size=(VERTICES, 9, 6)) * 0.003
    start = 0.001 * rng.normal(size=(VERTICES, 6))
    turn = turned(signals)
    own = np.stack([turn[:, j] for j in joint], 1)
    value = start + np.einsum("nvk,vkc->nvc", own, true)
    fitted, left = slice(0, 250), slice(250, POSES)
    found = rng.random(value.shape[:2]) < 0.8
    place, colour = value + 1e-3 * rng.normal(size=value.shape), np.full_like(value, 9.0)
    filled = np.where(found[..., None], value, np.where(np.arange(6) < 3, place, colour))
    parents = load_person().body.parents
    residuals = Residuals(signals[fitted], filled[fitted], found[fitted])
    mean, correction = fit_correction(residuals, joint, parents)
    error = np.abs(predicted(mean, correction, signals[left]) - value[left])
    assert np.median(error) < 0.1 * np.median(np.abs(value[left] - value.mean(0)))


def test_a_pose_far_from_the_fitted_ones_is_clipped(signals):
    turn = turned(signals)
    value = np.repeat(turn[:, ELBOW, :1, None] * [0.01, 0, 0, 0, 0, 0], 3, 1)
    residuals = Residuals(signals, value, np.ones(value.shape[:2], bool))
    mean, correction = fit_correction(residuals, np.full(3, ELBOW), load_person().body.parents)
    pose = np.zeros((55, 3))
    pose[ELBOW, 1] = np.pi
    far = predicted(mean, correction, [Signals.from_full_pose(pose)])
    assert np.abs(far).max() < 1.5 * np.abs(value).max()
