"""Filters: what they leave alone, and what they take away."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.signals.driving import Signals
from avatarrex.signals.filters import OneEuro, smoothed
from avatarrex.signals.sequence import SignalSequence


def of_elbow(angles: np.ndarray) -> SignalSequence:
    frames = []
    for angle in angles:
        pose = np.zeros((21, 3))
        pose[17] = (0, angle, 0)
        frames.append(Signals.rest().replace(body_pose=pose, translation=np.array([angle, 0, 0])))
    return SignalSequence(tuple(frames), 30.0)


def elbow(sequence: SignalSequence) -> np.ndarray:
    return np.array([frame.body_pose[17, 1] for frame in sequence])


def test_an_average_keeps_a_ramp_and_takes_noise_away() -> None:
    ramp = np.linspace(0, 1.5, 401)
    noise = 0.05 * np.random.default_rng(0).standard_normal(401)
    inner = slice(12, -12)
    assert elbow(smoothed(of_elbow(ramp), 0.1))[inner] == pytest.approx(ramp[inner], abs=1e-3)
    left = elbow(smoothed(of_elbow(ramp + noise), 0.1))[inner] - ramp[inner]
    # a Gaussian of 3 frames leaves 1 / sqrt(2 sqrt(pi) 3) = 0.31 of white noise
    assert left.std() < 0.45 * noise.std()
    made = smoothed(of_elbow(ramp), 0.1)
    assert np.array([frame.translation[0] for frame in made])[inner] == pytest.approx(ramp[inner], abs=1e-9)
    assert smoothed(of_elbow(ramp), 0.0)[7] == of_elbow(ramp)[7]


def test_an_average_goes_over_pi_and_not_through_rest() -> None:
    angles = np.linspace(2.6, 3.6, 41)
    turned = of_elbow(np.where(angles > np.pi, angles - 2 * np.pi, angles))
    assert np.abs(elbow(smoothed(turned, 0.2))).min() > 2.5


def test_one_euro_is_still_at_rest_and_quick_in_movement() -> None:
    random, filtered = np.random.default_rng(1), OneEuro()
    still = np.array([filtered(0.5 + 0.02 * random.standard_normal(3), 1 / 60) for _ in range(200)])[50:]
    assert still.std() < 0.5 * 0.02
    assert still.mean() == pytest.approx(0.5, abs=0.005)
    step = [filtered(np.full(3, 1.5), 1 / 60)[0] for _ in range(12)]
    assert step[11] > 1.4, "a fifth of a second after a jump"
    slow = OneEuro(beta=0.0)
    slow(np.zeros(1), 1 / 60)
    assert [slow(np.ones(1), 1 / 60)[0] for _ in range(3)][-1] < step[2] - 0.5, "without its speed it lags"
