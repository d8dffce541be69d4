"""Distances and winding numbers over a whole lattice against those point by point."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch
import trimesh

from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.ops.crossings import winding
from avatarrex.ops.mesh_lattice import Grid, PaintedMesh, nearest_vertex, paint_near, winding_lattice
from avatarrex.ops.search_tree import SearchTree
from avatarrex.signals.library import named_hand
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.person import load_person


@pytest.fixture(params=[1, 2])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def fist() -> tuple[np.ndarray, np.ndarray]:
    hand = load_person().left_hand
    vertices = pose_hand(hand, torch.as_tensor(named_hand("fist", "left")).float(), torch.zeros(10))
    return vertices.double().numpy(), hand.model.faces.numpy()


def around(vertices: np.ndarray, voxel: float) -> Grid:
    """Past one side of the mesh, cutting the other."""
    low, high = vertices.min(0) - 0.02, vertices.max(0) - 0.01
    x, y, z = np.ceil((high - low) / voxel).astype(int)
    return Grid(low, voxel, (int(z), int(y), int(x)))


def positions(grid: Grid) -> np.ndarray:
    return grid.position(np.arange(np.prod(grid.shape)))


def test_winding_numbers_of_a_fist_are_those_of_its_rays(threads: int) -> None:
    vertices, faces = fist()
    grid = around(vertices, 0.004)
    found = winding_lattice(vertices[faces], grid)
    assert np.array_equal(found.ravel(), winding(SearchTree.of_triangles(vertices, faces), positions(grid)))
    assert found.max() >= 2, "fingers in the palm"


def test_columns_through_corners_and_along_walls_are_counted_once() -> None:
    """Of a cube whose corners, edges and walls the columns meet exactly."""
    mesh = trimesh.creation.box((2.0, 2.0, 2.0)).subdivide().subdivide()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    grid = Grid(np.full(3, -2.0), 0.25, (17, 17, 17))
    found = winding_lattice(vertices[faces], grid)
    assert np.array_equal(found.ravel(), winding(SearchTree.of_triangles(vertices, faces), positions(grid)))
    assert set(np.unique(found)) == {0, 1}


@pytest.mark.parametrize("within", [0.004, 0.03])
def test_distance_and_paint_are_those_of_the_nearest_triangle(threads: int, within: float) -> None:
    vertices, faces = fist()
    grid, paint = around(vertices, 0.004), vertices[:, 0][faces]
    inside = winding_lattice(vertices[faces], grid) > 0
    values = np.full((*grid.shape, 2), 7, np.float32)
    count = paint_near(PaintedMesh(vertices[faces], paint), grid, inside, within, values)
    query = positions(grid)
    face, weight = closest_triangle(SearchTree.of_triangles(vertices, faces), query)
    nearest = (vertices[faces[face]] * weight[..., None]).sum(1)
    distance = np.linalg.norm(query - nearest, axis=-1)
    near = distance < within
    assert near.sum() == count > 1000
    assert (values.reshape(-1, 2)[~near] == 7).all()
    found = values.reshape(-1, 2)[near]
    np.testing.assert_allclose(found[:, 0], np.where(inside.ravel(), -distance, distance)[near], atol=1e-8)
    # Two surface points may be equally near.
    assert (np.abs(found[:, 1] - nearest[near, 0]) < 1e-6).mean() > 0.999


def test_slivers_and_points_for_triangles_are_as_far_as_their_edges() -> None:
    corner = np.array([[[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[0, 2, 0], [0, 2, 0], [0, 2, 0]]], float)
    grid = Grid(np.array([-0.5, -0.5, -0.5]), 0.25, (5, 14, 9))
    values = np.zeros((*grid.shape, 2), np.float32)
    paint_near(PaintedMesh(corner, np.zeros((2, 3))), grid, np.zeros(grid.shape, bool), 9.0, values)
    x, y, z = positions(grid).T
    segment = np.sqrt((x - x.clip(0, 1)) ** 2 + y**2 + z**2)
    want = np.minimum(segment, np.sqrt(x**2 + (y - 2) ** 2 + z**2))
    np.testing.assert_allclose(values[..., 0].ravel(), want, atol=1e-6)


@pytest.mark.parametrize("within", [0.004, 0.03])
def test_the_nearest_vertices_are_those_of_the_search(threads: int, within: float) -> None:
    """To the bit, and of equals the first."""
    vertices, _ = fist()
    grid = around(vertices, 0.004)
    vertices = np.concatenate(
        [vertices, vertices[:50], grid.position(np.array([5000])) + np.array([[0.002, 0, 0], [-0.002, 0, 0]])]
    )
    distance, number = nearest_vertex(vertices, grid, within)
    query = positions(grid)
    want, first = closest_vertex(SearchTree.of_vertices(vertices), query, within)
    assert np.array_equal(distance.ravel(), want)
    assert np.array_equal(number.ravel(), np.where(np.isfinite(want), first, -1))
