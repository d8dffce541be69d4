"""Colours of several poses become one: the median of what is sure."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.distil.bake import FAINT, Colours


def gathered(*poses: tuple[float, float]) -> float:
    """What grey values with weights become at the second of two places; the first has one colour alone."""
    colours = Colours(2)
    for grey, weight in poses:
        colours.add(np.array([1]), np.array([[grey] * 3 + [weight]], np.float32))
    colours.add(np.array([0]), np.array([[0.25] * 3 + [1.0]], np.float32))
    first, second = colours.merged()
    assert first == pytest.approx([0.25] * 3)
    return float(second[0])


def test_one_pose_that_folds_the_hem_leaves_no_trace():
    assert gathered((0.5, 1.0), (1.0, 1.0), (0.5, 1.0)) == 0.5


def test_the_median_of_an_even_number_is_between():
    assert gathered((0.5, 1.0), (0.25, 1.0), (1.0, 1.0), (0.0, 1.0)) == pytest.approx(0.375)


def test_what_is_not_sure_does_not_vote():
    assert gathered((0.5, 1.0), (1.0, FAINT), (1.0, FAINT)) == 0.5


def test_where_nothing_is_sure_weights_decide():
    assert gathered((0.2, 3e-3), (0.8, 1e-3)) == pytest.approx(0.35)
