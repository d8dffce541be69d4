"""The first triangle from outside: of sheets that lie on each other, back to back, or alone; and against a plain loop."""

import numpy as np
import pytest

from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.outer_triangle import FACES, outer_triangle
from avatarrex.ops.search_tree import SearchTree

REACH = (0.003, 0.004)
UP = np.array([0.0, 0.0, 1.0])


def sheet(height: float, up: bool = True, size: float = 0.02) -> np.ndarray:
    """Two triangles (2, 3, 3) of a square at `height`, facing up or down."""
    corner = size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float) + height * UP
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return corner[faces if up else faces[:, ::-1]]


def tree_of(*sheets: np.ndarray) -> SearchTree:
    corner = np.concatenate(sheets).reshape(-1, 3)
    return SearchTree.of_triangles(corner, np.arange(len(corner)).reshape(-1, 3))


def points_at(height: float, count: int = 50) -> np.ndarray:
    place = np.random.default_rng(0).uniform(-0.015, 0.015, (count, 3))
    place[:, 2] = height
    return place


def sheets_of(tree: SearchTree, points: np.ndarray, normal: np.ndarray = UP) -> list[int]:
    """Which sheets are found at the points."""
    found: list[int] = np.unique(
        outer_triangle(tree, points, np.tile(normal, (len(points), 1)), REACH)[0] // 2
    ).tolist()
    return found


@pytest.mark.parametrize("height", [-0.0005, 0.0005, 0.0013, 0.0025])
def test_a_closed_lid_is_before_the_ball(height: float) -> None:
    """Two sheets 2 mm apart that face the same way: the outer one, also where the ball is nearer."""
    assert sheets_of(tree_of(sheet(0.0), sheet(0.002)), points_at(height)) == [1]


def test_an_open_lid_is_not() -> None:
    """A sheet that ends before the point, or is too far before it, is not met."""
    beside = sheet(0.002) + np.array([0.05, 0, 0])
    assert sheets_of(tree_of(sheet(0.0), beside), points_at(0.0005)) == [0]
    assert sheets_of(tree_of(sheet(0.0), sheet(0.004)), points_at(0.0005)) == [0]


def test_front_and_back_of_a_thin_sheet_are_told_apart() -> None:
    """1 mm thick: a point that is nearer to the back has the front where its surface faces so, and the other way round."""
    thin = tree_of(sheet(0.0), sheet(-0.001, up=False))
    assert sheets_of(thin, points_at(-0.0009)) == [0]
    assert sheets_of(thin, points_at(-0.0001), -UP) == [1]


def test_what_is_missed_is_the_closest_that_faces_so() -> None:
    """6 mm off, beyond reach; where nothing faces so, whatever is closest."""
    assert sheets_of(tree_of(sheet(-0.0005), sheet(0.0, up=False)), points_at(0.006)) == [0]
    assert sheets_of(tree_of(sheet(0.0, up=False), sheet(0.01, up=False)), points_at(0.003)) == [0]


def test_on_a_single_convex_sheet_it_is_the_closest_triangle() -> None:
    """A ball of 3 cm, points up to 2 mm off it along its triangles' normals: the same triangles and places."""
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, 33), np.linspace(-1.2, 1.2, 17), indexing="ij")
    ball = 0.03 * np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], -1)
    a, b, c, d = (part.reshape(-1, 3) for part in (ball[:-1, :-1], ball[1:, :-1], ball[1:, 1:], ball[:-1, 1:]))
    corner = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rng = np.random.default_rng(1)
    points = corner.mean(1) + rng.uniform(-0.002, 0.002, (len(corner), 1)) * normal
    tree = tree_of(corner)
    face, weight = outer_triangle(tree, points, normal, REACH)
    closest, place = closest_triangle(tree, points)
    np.testing.assert_array_equal(face, closest)
    np.testing.assert_allclose(weight, place, atol=1e-9)


def test_it_is_what_a_plain_loop_finds() -> None:
    """Triangles everywhere: the first of those that a ray meets and that face as it does."""
    rng = np.random.default_rng(2)
    corner = rng.uniform(-0.01, 0.01, (80, 1, 3)) + rng.normal(0, 0.004, (80, 3, 3))
    points, normals = rng.uniform(-0.01, 0.01, (300, 3)), rng.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    face, weight = outer_triangle(tree_of(corner), points, normals, REACH)
    met = 0
    for p, n, f, found in zip(points, normals, face, weight):
        first, expected = sum(REACH), None
        for t, (a, b, c) in enumerate(corner):
            across = np.cross(b - a, c - a)
            if across @ n <= FACES * np.linalg.norm(across):
                continue
            v, w, along = np.linalg.solve(np.stack([b - a, c - a, n], 1), p + REACH[0] * n - a)
            if min(v, w, 1 - v - w) >= 0 and 0 <= along < first:
                first, expected = along, (t, np.array([1 - v - w, v, w]))
        if expected is not None:
            met += 1
            assert f == expected[0]
            np.testing.assert_allclose(found, expected[1], atol=1e-9)
    assert met > 50
