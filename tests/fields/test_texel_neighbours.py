"""Neighbours of texels: those a spacing apart, within a triangle and over its edges, whatever their number."""

import numpy as np
import pytest

from avatarrex.fields.detail_texture import texel_count
from avatarrex.fields.texel_neighbours import texel_neighbours

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def places(edge: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(t, 3) of the texels of triangles on the square, one by one."""
    found = []
    for r, face in zip(edge.tolist(), faces):
        steps = [(i, j, r - i - j) for i in range(r + 1) for j in range(r + 1 - i)] if r else []
        found += [np.array(step) / r @ SQUARE[face] for step in steps]
    return np.array(found)


@pytest.mark.parametrize("faces", [[[0, 1, 2], [0, 2, 3]], [[2, 0, 1], [3, 0, 2]], [[0, 1, 2], [2, 0, 3]]])
def test_equal_lattices_meet_at_their_edge(faces: list[list[int]]) -> None:
    edge, mesh = np.array([4, 4]), np.array(faces)
    pairs, place = texel_neighbours(edge, mesh), places(edge, mesh)
    apart = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    assert (apart < 1e-12).sum() == 5  # of the diagonal, one for one
    assert np.sort(np.unique(apart.round(9))).tolist() == pytest.approx([0, 0.25, 0.25 * 2**0.5])
    within = 3 * (4 * 5 // 2)
    assert len(pairs) == 2 * within + 5


def test_a_coarser_lattice_meets_a_finer_one_at_the_nearest() -> None:
    edge, mesh = np.array([2, 6]), np.array([[0, 1, 2], [0, 2, 3]])
    pairs, place = texel_neighbours(edge, mesh), places(edge, mesh)
    first = int(texel_count(edge)[0])
    over = pairs[(pairs < first).sum(1) == 1]
    apart = np.linalg.norm(place[over[:, 0]] - place[over[:, 1]], axis=1)
    assert set(over[:, 1]) == {first + k for k in range(28) if abs(place[first + k] @ (1, -1, 0)) < 1e-12}
    assert apart.max() <= 2**0.5 / 4 + 1e-12  # half a step of the coarser


def test_triangles_without_texels_have_no_neighbours() -> None:
    pairs = texel_neighbours(np.array([3, 0]), np.array([[0, 1, 2], [0, 2, 3]]))
    assert pairs.max() < 10
    assert len(pairs) == 18
