"""What was not found lies between its neighbours, what was found is not touched."""

from __future__ import annotations

import numpy as np

from avatarrex.distil.gaps import filled, tension


def grid(side: int) -> np.ndarray:
    """Faces of a square of `side` × `side` vertices."""
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    return np.concatenate(
        [np.stack([corner, corner + 1, corner + side], 1), np.stack([corner + 1, corner + side + 1, corner + side], 1)]
    )


def test_a_gap_is_the_smoothest_continuation_of_what_is_around_it():
    """A plane with a hole in it: the hole has the plane, though something else was seen there."""
    side = 9
    value = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2).astype(float)
    found = np.abs(value - 4).max(1) > 2
    seen = np.where(found[:, None], value, 99.0)
    assert np.allclose(filled(seen, found, tension(grid(side), side**2)), value, atol=0.01)


def test_what_was_found_stays_bit_for_bit():
    rng = np.random.default_rng(0)
    value, found = rng.normal(size=(25, 6)), rng.random(25) < 0.7
    out = filled(value, found, tension(grid(5), 25))
    assert np.array_equal(out[found], value[found])
    assert not np.isclose(out[~found], value[~found]).any()


def test_a_piece_of_which_nothing_was_found_has_nothing():
    faces = np.concatenate([grid(3), grid(3) + 9])
    out = filled(np.full((18, 3), 0.5), np.arange(18) < 9, tension(faces, 18))
    assert np.array_equal(out[9:], np.zeros((9, 3)))
