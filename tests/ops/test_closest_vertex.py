"""The tree of vertices against every vertex."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from avatarrex.ops.closest_vertex import closest_vertex, closest_vertices
from avatarrex.ops.search_tree import SearchTree

RNG = np.random.default_rng(4)
CLOUDS = {
    "scattered": RNG.normal(size=(500, 3)),
    "a lattice, of many equals": np.stack(np.meshgrid(*[np.arange(7.0)] * 3), -1).reshape(-1, 3),
    "each twice": np.repeat(RNG.normal(size=(90, 3)), 2, 0),
    "all at one place": np.ones((40, 3)),
    "one": np.zeros((1, 3)),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_it_finds_what_every_vertex_finds(name: str) -> None:
    """And of equals the first, wherever the search began."""
    cloud = CLOUDS[name]
    points = np.concatenate([RNG.normal(size=(300, 3)), np.round(2 * RNG.normal(size=(300, 3))) / 2 + 3, cloud])
    distance, vertex = closest_vertex(SearchTree.of_vertices(cloud), points)
    square = ((points[:, None] - cloud) ** 2).sum(-1)
    np.testing.assert_array_equal(vertex, square.argmin(1))
    np.testing.assert_allclose(distance, cdist(points, cloud).min(1), atol=1e-12)


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("wanted", [1, 2, 9, 33])
def test_several_are_those_of_every_vertex(name: str, wanted: int) -> None:
    cloud = CLOUDS[name]
    wanted = min(wanted, len(cloud))
    points = np.concatenate([RNG.normal(size=(300, 3)), cloud])
    distance, vertex = closest_vertices(SearchTree.of_vertices(cloud), points, wanted)
    every = cdist(points, cloud)
    np.testing.assert_allclose(distance, np.sort(every, 1)[:, :wanted], atol=1e-12)
    np.testing.assert_allclose(np.take_along_axis(every, vertex, 1), distance, atol=1e-12)
    assert all(len(set(row)) == wanted for row in vertex.tolist())


def test_more_than_there_are_is_refused() -> None:
    for count in (0, 4):
        with pytest.raises(ValueError, match=f"{count} of 3 vertices"):
            closest_vertices(SearchTree.of_vertices(np.eye(3)), np.zeros((1, 3)), count)


def test_none_is_found_beyond_the_given_reach() -> None:
    """On the way from one cluster to another the vertex before is too far, and comes back."""
    cloud = CLOUDS["scattered"]
    points = np.linspace(-14, 14, 3000)[:, None] * np.ones(3) / np.sqrt(3)
    free, first = closest_vertex(SearchTree.of_vertices(cloud), points)
    for within in (0.3, 1.0, 4.0):
        distance, vertex = closest_vertex(SearchTree.of_vertices(cloud), points, within)
        near = free < within
        assert 0 < near.sum() < len(points)
        np.testing.assert_array_equal(distance, np.where(near, free, np.inf))
        np.testing.assert_array_equal(vertex[near], first[near])


def test_what_is_not_finite_is_refused() -> None:
    """As scipy's tree does: a broken vertex is not one that nothing is near to."""
    with pytest.raises(ValueError, match="finite"):
        SearchTree.of_vertices(np.full((3, 3), np.nan))
    with pytest.raises(ValueError, match="finite"):
        closest_vertex(SearchTree.of_vertices(np.zeros((3, 3))), np.full((1, 3), np.inf))


def test_no_point() -> None:
    assert closest_vertex(SearchTree.of_vertices(np.zeros((3, 3))), np.zeros((0, 3)))[0].shape == (0,)
