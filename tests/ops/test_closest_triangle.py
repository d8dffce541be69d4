"""The tree of triangles against every triangle."""

from dataclasses import fields

import numpy as np
import pytest
import torch

from avatarrex.avatar_file import load_avatar
from avatarrex.fields.composition import BAND
from avatarrex.ops import native
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.closest_triangle import BOUND_MARGIN, closest_triangle, signed_closest
from avatarrex.ops.pseudonormal import pseudonormals, pseudonormals_reference
from avatarrex.ops.search_tree import SearchTree
from avatarrex.ops.triangle import closest_on_triangle
from avatarrex.signals.library import named_hand
from avatarrex.templates.hand import pose_hand


@pytest.fixture(scope="module", params=["flat", "fist", "spread"])
def hand(request: pytest.FixtureRequest) -> tuple[torch.Tensor, torch.Tensor]:
    """A posed left hand: vertices and faces."""
    person = load_avatar().person
    pose = torch.as_tensor(np.asarray(named_hand(request.param, "left")), dtype=torch.float32)
    return pose_hand(person.left_hand, pose, torch.zeros(10)), person.left_hand.model.faces


def closest(vertices: torch.Tensor, faces: torch.Tensor, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Face and barycentrics."""
    tree = SearchTree.of_triangles(vertices.numpy(), faces.numpy())
    face, weight = closest_triangle(tree, points.numpy())
    return torch.from_numpy(face), torch.from_numpy(weight)


def beside(hand: tuple[torch.Tensor, torch.Tensor], off: float) -> torch.Tensor:
    """Points on every triangle, moved by `off` metres in random directions."""
    vertices, faces = hand
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(len(faces), 3, generator=generator)
    points = (vertices[faces] * (share / share.sum(1, keepdim=True))[..., None]).sum(1)
    way = torch.nn.functional.normalize(torch.randn(points.shape, generator=generator), dim=-1)
    return points + off * way


@pytest.mark.parametrize("off", [0.0, 0.001, 0.08, 5.0])
def test_it_finds_what_every_triangle_finds(hand: tuple[torch.Tensor, torch.Tensor], off: float) -> None:
    """And the barycentrics that the reference has, to the last digits."""
    vertices, faces = hand
    points = beside(hand, off)[:400]
    face, weight = closest(vertices, faces, points)
    exact = closest_point(vertices.double(), faces, points.double(), impl="reference")
    there = (vertices.double()[faces[face]] * weight[..., None]).sum(1)
    torch.testing.assert_close((points.double() - there).norm(dim=-1), exact.sdf.abs(), atol=1e-12, rtol=1e-12)
    own = closest_on_triangle(points.double(), *vertices.double()[faces[face]].unbind(1))[1]
    torch.testing.assert_close(weight, own, atol=1e-10, rtol=0)
    assert torch.equal(weight == 0, own == 0), "the same features"


def test_signs_and_gradients_are_those_of_every_triangle(hand: tuple[torch.Tensor, torch.Tensor]) -> None:
    vertices, faces = hand
    points = beside(hand, 0.01).requires_grad_()
    for impl in ("tree", "reference"):
        points.grad = None
        found = closest_point(vertices, faces, points, BAND, impl)
        found.sdf.sum().backward()
        if impl == "tree":
            mine, slope = found, points.grad.clone()
    torch.testing.assert_close(mine.sdf, found.sdf)
    assert (found.sdf < 0).any()
    torch.testing.assert_close(slope, points.grad, atol=1e-3, rtol=0)


def test_threads_change_no_distance(hand: tuple[torch.Tensor, torch.Tensor], monkeypatch) -> None:
    monkeypatch.setattr(native, "FEW", 10)
    points, before, found = beside(hand, 0.01), torch.get_num_threads(), []
    signs: list[torch.Tensor] = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            face, weight = closest(*hand, points)
            found.append((hand[0].double()[hand[1][face]] * weight[..., None]).sum(1))
            signs.append(closest_point(*hand, 4 * points, BAND).sdf)
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(*found, atol=1e-12, rtol=0)
    assert signs[0].equal(signs[1]), "nor a side, wherever a row is cut"


def test_a_mesh_of_one_box() -> None:
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(1)) * 1.2 - 0.3
    found, exact = (closest_point(vertices, faces, points, impl=impl) for impl in ("tree", "reference"))
    torch.testing.assert_close(found.sdf, exact.sdf)
    assert (found.sdf < 0).any()


def test_no_triangle_and_a_vertex_that_is_not_there() -> None:
    with pytest.raises(ValueError, match="nothing"):
        SearchTree.of_triangles(np.eye(3), np.zeros((0, 3), int))
    with pytest.raises(IndexError, match="0 to 7 of 3"):
        pseudonormals(torch.eye(3).double(), torch.tensor([[0, 1, 7]]))


def test_one_triangle_and_no_point() -> None:
    tree = SearchTree.of_triangles(np.eye(3), np.array([[0, 1, 2]]))
    assert closest_triangle(tree, np.zeros((1, 3)))[0].tolist() == [0]
    assert closest_triangle(tree, np.zeros((0, 3)))[1].shape == (0, 3)


def test_triangles_at_one_place_are_one_run_of_boxes() -> None:
    """No extent to sort along, and more of them than one box holds."""
    faces = torch.tensor([[0, 1, 2]]).repeat(100, 1)
    face, weight = closest(torch.eye(3), faces, torch.rand(20, 3))
    assert weight.sum(1).sub(1).abs().max() < 1e-12
    assert (face < 100).all()


def test_a_needle_is_its_longest_side() -> None:
    """Too thin for a normal: as far off as its sides are, wherever the point."""
    corner = torch.tensor([[0.5, 1e-13, 1e-13], [0, 0, 0], [1, 0, 0]], dtype=torch.float64)
    points = torch.randn(200, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    _, weight = closest(corner, torch.tensor([[0, 1, 2]]), points)
    along = points[:, 0].clamp(0, 1)
    side = (points - torch.nn.functional.pad(along[:, None], (0, 2))).norm(dim=-1)
    torch.testing.assert_close((points - weight @ corner).norm(dim=-1), side, atol=1e-12, rtol=0)


def test_a_row_of_points_that_leaves_the_bound_and_comes_back(hand: tuple[torch.Tensor, torch.Tensor]) -> None:
    """Points on a lattice reach 20 cm away: those beyond the bound are not searched, and all are on their side."""
    vertices, faces = hand
    axis = torch.linspace(-0.25, 0.25, 24)
    points = torch.cartesian_prod(axis, axis, axis) + vertices.mean(0)
    free = closest_point(vertices.double(), faces, points.double(), impl="tree").sdf
    bounded = closest_point(vertices, faces, points, BAND, "tree").sdf
    torch.testing.assert_close(bounded.double(), free.clamp(*BAND), atol=1e-6, rtol=0)
    tree, normals = SearchTree.of_triangles(vertices.numpy(), faces.numpy()), pseudonormals(vertices.double(), faces)
    signed = signed_closest(tree, points.numpy(), faces.int().numpy(), normals, BAND)
    found, face, weight, unsure = map(torch.from_numpy, signed)
    assert not unsure.any()
    apart = (points.double() - (vertices.double()[faces[face]] * weight[..., None]).sum(1)).norm(dim=-1)
    skipped = found == BAND[1]
    assert 0.3 < skipped.double().mean() < 0.95, "far points are not searched"
    assert free[skipped].min() > BAND[1] + BOUND_MARGIN, "and near ones are"
    torch.testing.assert_close(apart[~skipped], free[~skipped].abs(), atol=1e-6, rtol=0)
    assert (bounded < 0).any()


@pytest.mark.parametrize("name", ["hand", "torn", "doubled"])
def test_compiled_pseudonormals_are_those_in_torch(hand: tuple[torch.Tensor, torch.Tensor], name: str) -> None:
    """A hand; every corner a vertex of its own; repeated and turned triangles beside some without an area."""
    vertices, faces = hand[0].double(), hand[1]
    if name == "torn":
        vertices, faces = vertices[faces].reshape(-1, 3), torch.arange(3 * len(faces)).reshape(-1, 3)
    if name == "doubled":
        turned, flat = faces[:50].roll(1, 1), faces[:20, [0, 0, 1]]
        faces = torch.cat([faces[:200], turned, faces[:30].flip(1), flat, faces[200:]])
        vertices = vertices.clone()
        vertices[faces[300, 2]] = vertices[faces[300, :2]].mean(0)
    found, want = pseudonormals(vertices, faces), pseudonormals_reference(vertices, faces)
    for field in fields(want):
        torch.testing.assert_close(getattr(found, field.name), getattr(want, field.name), atol=1e-12, rtol=0)
    assert (name == "doubled") == bool((~found.kept).any()) == bool(found.flat_edge.any())
