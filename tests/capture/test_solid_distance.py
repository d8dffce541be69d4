"""Winding numbers and distances of solids: closed form (boxes), then libigl and order invariance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from avatarrex.capture.synthetic.solid_distance import SolidUnion
from avatarrex.errors import InputError

igl = pytest.importorskip("igl")


def boxes(*specs: tuple[tuple[float, float, float], float], rounds: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Axis-parallel cubes (centre, half width), finely meshed, in one array pair."""
    vertices, faces, count = [], [], 0
    for centre, half in specs:
        mesh = trimesh.creation.box(extents=[2 * half] * 3)
        for _ in range(rounds):
            mesh = mesh.subdivide()
        vertices.append(np.asarray(mesh.vertices) + centre)
        faces.append(np.asarray(mesh.faces) + count)
        count += len(mesh.vertices)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int64)


def box_distance(points: np.ndarray, centre: tuple[float, float, float], half: float) -> np.ndarray:
    q = np.abs(points - centre) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)


def test_one_box_matches_the_closed_form(rng: np.random.Generator) -> None:
    union = SolidUnion(*boxes(((0.1, 0, 0), 0.1)))
    points = rng.uniform(-0.25, 0.35, (4000, 3))
    expected = box_distance(points, (0.1, 0, 0), 0.1)
    np.testing.assert_allclose(union.signed_distance(points), expected, atol=1e-12)
    assert np.abs(union.signed_distance(points) + expected).max() > 0.1, "a flipped sign must be seen"


def test_buried_faces_do_not_count(rng: np.random.Generator) -> None:
    """A small cube inside a large one, and one that overlaps it: outside exact, inside no distance to buried walls."""
    union = SolidUnion(*boxes(((0, 0, 0), 0.1), ((0.01, 0, 0), 0.03), ((0.12, 0, 0), 0.05)))
    points = rng.uniform(-0.2, 0.25, (4000, 3))
    large, right = box_distance(points, (0, 0, 0), 0.1), box_distance(points, (0.12, 0, 0), 0.05)
    outside = np.minimum(large, right) > 0
    found = union.signed_distance(points)
    np.testing.assert_allclose(found[outside], np.minimum(large, right)[outside], atol=1e-12)
    assert (found[~outside] < 0).all()
    deep = (large < -0.02) & (points[:, 0] < 0)
    np.testing.assert_allclose(found[deep], large[deep], atol=1e-12)
    assert len(union.outer) < len(union.faces)


def test_winding_counts_overlaps_and_agrees_with_libigl(rng: np.random.Generator) -> None:
    vertices, faces = boxes(((0, 0, 0), 0.1), ((0.05, 0.02, 0), 0.1))
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    vertices = vertices @ turn.T
    points = rng.uniform(-0.2, 0.2, (5000, 3))
    found = SolidUnion(vertices, faces).winding(points)
    np.testing.assert_array_equal(found, np.round(igl.winding_number(vertices, faces, points)))
    assert set(found) == {0, 1, 2}


def test_rays_through_edges_and_vertices_count_once() -> None:
    """Rays that pass exactly through the mesh's vertices and edges: never zero, never two."""
    vertices, faces = boxes(((0, 0, 0), 0.125), rounds=2)
    grid = np.linspace(-0.125, 0.125, 9)[1:-1]
    points = np.stack([*np.meshgrid(grid, grid, [-0.3, 0.0, 0.3])], -1).reshape(-1, 3)
    np.testing.assert_array_equal(SolidUnion(vertices, faces).winding(points), (points[:, 2] == 0).astype(int))


def test_the_order_of_solids_does_not_matter(rng: np.random.Generator) -> None:
    specs = [((0, 0, 0), 0.1), ((0.08, 0.05, 0), 0.07), ((-0.05, 0, 0.09), 0.05)]
    points = rng.uniform(-0.2, 0.2, (2000, 3))
    first = SolidUnion(*boxes(*specs)).signed_distance(points)
    np.testing.assert_allclose(first, SolidUnion(*boxes(*specs[::-1])).signed_distance(points), atol=1e-13)


def test_samples_lie_on_the_outer_surface_only(rng: np.random.Generator) -> None:
    union = SolidUnion(*boxes(((0, 0, 0), 0.1), ((0.12, 0, 0), 0.05)))
    face, bary = union.sample(2000, rng, np.arange(len(union.faces)))
    points = np.einsum("pk,pkc->pc", bary, union.vertices[union.faces[face]])
    both = np.minimum(box_distance(points, (0, 0, 0), 0.1), box_distance(points, (0.12, 0, 0), 0.05))
    assert np.abs(both).max() < 1e-9
    right = points[:, 0] > 0.1 + 1e-9
    share = (5 * 0.1**2 - 4 * 0.03 * 0.1) / (5 * 0.1**2 - 4 * 0.03 * 0.1 + 6 * 0.2**2 - 0.1**2)
    assert abs(right.mean() - share) < 4 * np.sqrt(share * (1 - share) / 2000)


def test_points_of_the_wrong_shape_are_refused() -> None:
    union = SolidUnion(*boxes(((0, 0, 0), 0.1)))
    with pytest.raises(InputError, match="shape"):
        union.signed_distance(np.zeros((3, 2)))
    with pytest.raises(InputError, match="outer surface"):
        union.sample(10, np.random.default_rng(0), np.empty(0, dtype=np.int64))
