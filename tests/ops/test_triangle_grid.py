"""Closest triangles by a table of cells, against the search tree."""

import numpy as np

from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.triangle_grid import FAR, TriangleGrid
from avatarrex.templates.person import load_person


def gaps(points: np.ndarray, corner: np.ndarray, found: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Distances of the points to their closest ones."""
    face, weight = found
    place = np.einsum("pk,pkc->pc", weight, corner[face])
    return np.asarray(np.linalg.norm(points - place, axis=1))


def test_closest_on_a_body() -> None:
    """Near the skin the table finds what the tree finds, but for few points between two sheets."""
    model = load_person().body
    vertices, faces = model.v_template.double().numpy(), model.faces.numpy()
    grid, rng = TriangleGrid.of(vertices, faces), np.random.default_rng(0)
    corner = vertices[faces]
    skin = np.flatnonzero(
        np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=-1).min(1) > 0.008
    )  # no mouth, no eyeballs
    points = corner[rng.choice(skin, 20_000)].mean(1) + rng.normal(0, 0.006, (20_000, 3))
    exact, ours = (gaps(points, corner, found) for found in (closest_triangle(grid.tree, points), grid.closest(points)))
    assert (ours >= exact - 1e-12).all()
    assert (ours > exact + 1e-4).mean() < 0.03
    assert np.quantile(ours - exact, 0.999) < 0.01


def test_far_points_are_searched() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    grid = TriangleGrid.of(vertices, np.array([[0, 1, 2]]))
    points = np.array([[0.25, 0.25, 2 * FAR], [0.25, 0.25, -5.0], [2, -1, 0.01]])
    face, weight = grid.closest(points)
    assert face.tolist() == [0, 0, 0]
    np.testing.assert_allclose(weight, [[0.5, 0.25, 0.25], [0.5, 0.25, 0.25], [0, 1, 0]], atol=1e-12)


def test_points_walk_over_edges_to_their_triangle() -> None:
    """A strip of narrow triangles, ten to a cell: the cell's triangle is mostly not the one."""
    x = np.linspace(0, 0.2, 201)
    vertices = np.concatenate([np.stack([x, 0 * x + y, 0 * x], 1) for y in (0, 0.05)])
    first = np.arange(200)
    faces = np.concatenate(
        [np.stack([first, first + 1, first + 201], 1), np.stack([first + 1, first + 202, first + 201], 1)]
    )
    points = np.random.default_rng(0).uniform([0.01, 0.01, -0.002], [0.19, 0.04, 0.002], (2000, 3))
    face, weight = TriangleGrid.of(vertices, faces).closest(points)
    np.testing.assert_allclose(np.einsum("pk,pkc->pc", weight, vertices[faces[face]])[:, :2], points[:, :2], atol=1e-9)
