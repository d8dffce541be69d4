"""Look-ups beside a mesh against the exact search."""

import numpy as np
import pytest
import torch

from avatarrex.avatar import load_avatar
from avatarrex.ops.closest_near import NEIGHBOURS, NearMesh
from avatarrex.ops.closest_point import closest_point
from avatarrex.signals.library import named_hand
from avatarrex.templates.hand import pose_hand


@pytest.fixture(scope="module", params=["flat", "fist", "spread"])
def hand(request: pytest.FixtureRequest) -> tuple[torch.Tensor, torch.Tensor]:
    """A posed left hand: vertices and faces."""
    person = load_avatar().person
    pose = torch.as_tensor(np.asarray(named_hand(request.param, "left")), dtype=torch.float32)
    return pose_hand(person.left_hand, pose, torch.zeros(10)), person.left_hand.model.faces


def beside(hand: tuple[torch.Tensor, torch.Tensor], off: float) -> torch.Tensor:
    """Points on every triangle, moved by `off` metres in random directions."""
    vertices, faces = hand
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(len(faces), 3, generator=generator)
    points = (vertices[faces] * (share / share.sum(1, keepdim=True))[..., None]).sum(1)
    way = torch.nn.functional.normalize(torch.randn(points.shape, generator=generator), dim=-1)
    return points + off * way


@pytest.mark.parametrize("off", [0.0, 0.001, 0.004])
def test_points_beside_the_hand_find_their_triangle(hand: tuple[torch.Tensor, torch.Tensor], off: float) -> None:
    points = beside(hand, off)
    found, exact = NearMesh.of(*hand).closest(points), closest_point(*hand, points)
    apart = (found.sdf - exact.sdf).abs()
    assert (apart > 1e-6).float().mean() < 0.02
    assert apart.mean() < 3e-5
    assert apart.max() < 0.01


def test_far_points_may_find_another_and_never_a_nearer_one(hand: tuple[torch.Tensor, torch.Tensor]) -> None:
    points = beside(hand, 0.08)
    found, exact = NearMesh.of(*hand).closest(points), closest_point(*hand, points)
    assert (found.sdf.abs() >= exact.sdf.abs() - 1e-6).all()
    assert (found.sdf - exact.sdf).abs().max() < 0.02


def test_a_mesh_with_fewer_triangles_than_neighbours() -> None:
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert len(faces) < NEIGHBOURS
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(1)) * 1.2 - 0.3
    found, exact = NearMesh.of(vertices, faces).closest(points), closest_point(vertices, faces, points)
    torch.testing.assert_close(found.sdf, exact.sdf)
    assert (found.sdf < 0).any()


def test_one_triangle_and_no_point() -> None:
    mesh = NearMesh.of(torch.eye(3), torch.tensor([[0, 1, 2]]))
    assert mesh.closest(torch.zeros(1, 3)).face.tolist() == [0]
    assert mesh.closest(torch.zeros(0, 3)).sdf.shape == (0,)
