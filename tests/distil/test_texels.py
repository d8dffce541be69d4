"""Texels of an atlas: whose centres a triangle covers, where they are in it, and what is between the charts."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.distil.texels import texels

FACE = np.array([[0, 1, 2]], np.int32)


def test_a_triangle_covers_the_texels_whose_centres_are_in_it():
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    found = texels(uv, FACE, 4, 4)
    assert found.inside.astype(int).tolist() == [[1, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 0], [1, 0, 0, 0]]
    assert found.barycentric[0] == pytest.approx([0.75, 0.125, 0.125])
    assert found.barycentric[6] == pytest.approx([0, 0.625, 0.375])


def test_a_triangle_without_area_covers_nothing():
    uv = np.array([[0, 0], [1, 1], [0.5, 0.5]], np.float32)
    assert not texels(uv, FACE, 8, 8).inside.any()


def test_vertex_values_are_interpolated_and_the_nearest_fills_the_rest():
    """The texture's height and width differ; x + 10 y at the centres, and the same beyond the edge."""
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    found = texels(uv, FACE, 4, 8)
    picture = found.image(found.interpolated(FACE, np.array([[0.0], [8.0], [40.0]])))
    rows, columns = np.nonzero(found.inside)
    assert picture[rows, columns, 0] == pytest.approx(columns + 0.5 + 10 * (rows + 0.5), abs=1e-5)
    assert picture[3, 7, 0] in picture[rows, columns, 0]
