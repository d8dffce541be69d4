"""Winding numbers by signed crossings against solid angles, and where rays are worst."""

import numpy as np
import pytest
import torch
import trimesh

from avatarrex.ops.crossings import winding
from avatarrex.ops.pseudonormal import winding_number
from avatarrex.ops.search_tree import SearchTree
from avatarrex.signals.library import named_hand
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.person import load_person


def tensors(mesh: trimesh.Trimesh) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor(np.asarray(mesh.vertices)), torch.tensor(np.asarray(mesh.faces, np.int64))


def wound(vertices: torch.Tensor, faces: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy(winding(SearchTree.of_triangles(vertices.numpy(), faces.numpy()), points.numpy()))


@pytest.mark.parametrize("pose", ["flat", "fist", "point"])
def test_it_is_the_sum_of_solid_angles(pose: str) -> None:
    hand = load_person().left_hand
    vertices = pose_hand(hand, torch.as_tensor(named_hand(pose, "left")).float(), torch.zeros(10)).double()
    faces = hand.model.faces
    generator = torch.Generator().manual_seed(0)
    points = vertices[::2] + 0.004 * torch.randn(len(vertices[::2]), 3, generator=generator, dtype=torch.float64)
    found = wound(vertices, faces, points)
    assert torch.equal(found, winding_number(vertices, faces, points).round().long())
    assert found.max() == (1 if pose == "flat" else 2), "fingers in the palm"


def test_rays_through_corners_and_along_walls_are_counted_once() -> None:
    """Of a cube whose corners, edges and walls the rays meet exactly."""
    vertices, faces = tensors(trimesh.creation.box((2.0, 2.0, 2.0)).subdivide().subdivide())
    side = torch.arange(-8, 9, dtype=torch.float64) / 4
    points = torch.cartesian_prod(side, side, side) + torch.tensor([0.0, 0.0, 0.1])
    clear = ((points.abs() - 1).abs() > 1e-6).all(-1)
    found = wound(vertices, faces, points)
    assert torch.equal(found[clear], (points.abs() < 1).all(-1)[clear].long())
    assert found.min() == 0
    assert found.max() == 1


def test_solids_in_solids_and_solids_turned_inside_out_add_up() -> None:
    outer, inner = trimesh.creation.icosphere(3, 1.0), trimesh.creation.icosphere(3, 0.5)
    middle = torch.zeros(1, 3, dtype=torch.float64)
    for mesh, want in ((outer + inner, 2), (outer + trimesh.Trimesh(inner.vertices, inner.faces[:, ::-1]), 0)):
        assert wound(*tensors(mesh), middle).item() == want
    assert wound(*tensors(outer), middle + 3).item() == 0
