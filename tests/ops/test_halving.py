"""Compiled passes over a lattice against numpy's."""

import numpy as np
import pytest

from avatarrex.ops.halving import between, between_reference, touched, touched_reference


@pytest.mark.parametrize("shape", [(3, 4, 5), (6, 2, 3, 2), (1, 1, 4), (17, 40, 30, 2)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_means_are_rounded_as_the_reference_rounds(shape: tuple[int, ...], dtype: type[np.floating]) -> None:
    values: np.ndarray = np.random.default_rng(0).normal(size=shape).astype(dtype)
    fine = between(values)
    assert fine.dtype == dtype
    assert np.array_equal(fine, between_reference(values))


def test_a_view_is_halved_as_its_copy() -> None:
    values = np.random.default_rng(1).normal(size=(4, 5, 6, 2))
    assert np.array_equal(between(values[..., 0]), between_reference(values[..., 0].copy()))


@pytest.mark.parametrize("shape", [(1, 4, 5, 6), (7, 3, 3, 3), (2, 1, 3, 3), (1, 40, 50, 60)])
def test_corners_of_crossed_cells_are_those_of_the_reference(shape: tuple[int, ...]) -> None:
    draw = np.random.default_rng(2)
    for shares in ((1, 0, 0), (0.98, 0, 0.02), (0.4, 0.2, 0.4), (0.02, 0.96, 0.02)):
        side = draw.choice(np.array([-1, 0, 1], np.int8), shape, p=shares)
        assert np.array_equal(touched(side), touched_reference(side))
