"""What a surface's correction misses, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.distil.fit import Residuals, fit_correction
from avatarrex.measure.studies.surface_curve import missed, predicted
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals
from avatarrex.surface.pose_kernel import turns
from avatarrex.templates.person import load_person

ELBOW = 18


def test_it_is_told_along_the_normal_and_along_the_skin():
    """3 mm along +Z and 4 mm aside, 0.1 in colour; vertices that were not found or are not looked at do not count."""
    true = Residuals([Signals.rest()], np.zeros((1, 4, 6)), np.array([[True, True, False, True]]))
    guess = np.tile([0.004, 0, 0.003, 0.1, 0.1, 0.1], (1, 4, 1))
    guess[0, 2:] = 9.0
    normal = np.tile([0.0, 0, 1], (4, 1))
    found = missed(true, guess, normal, np.array([True, True, True, False]))
    assert found == pytest.approx((3.0, 3.0, 4.0, 20.0))


def test_what_is_predicted_is_what_was_fitted():
    """One row of an elbow's turn moves the vertices; poses that were fitted come back."""
    rng = np.random.default_rng(0)
    signals = [random_signals(rng) for _ in range(40)]
    own = turns(np.stack([one.full_pose() for one in signals]))[:, ELBOW]
    value = np.repeat(own[:, None, :1] * [0.01, 0, 0, 0, 0, 0.1], 3, 1)
    residuals = Residuals(signals, value, np.ones((40, 3), bool))
    parents = load_person().body.parents
    error = {}
    for rank in (0, 4):
        mean, correction = fit_correction(residuals, np.full(3, ELBOW), parents, rank)
        error[rank] = np.abs(predicted(mean, correction, signals) - value).mean()
    assert error[4] < 0.1 * error[0]
