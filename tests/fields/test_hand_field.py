"""Hand field: distances to simple hands, ω and colour by barycentrics, gradients into every parameter."""

from functools import cache

import pytest
import torch
import trimesh
from torch import Tensor

from avatarrex.fields.hand import HandField
from avatarrex.fields.presets import PRESETS
from avatarrex.ops.closest_point import Impl, closest_point
from avatarrex.ops.crossings import winding
from avatarrex.ops.pseudonormal import winding_number
from avatarrex.signals.library import named_hand
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.person import load_person


@cache
def hand(side: str = "left") -> HandField:
    torch.manual_seed(0)
    return HandField(getattr(load_person(), f"{side}_hand"), PRESETS["compact"])


@cache
def flat(side: str = "left") -> Tensor:
    return pose_hand(getattr(load_person(), f"{side}_hand"), torch.zeros(15, 3), torch.zeros(10))


def near(vertices: Tensor, count: int, spread: float = 0.015) -> Tensor:
    generator = torch.Generator().manual_seed(count)
    rows = torch.randint(len(vertices), (count,), generator=generator)
    return vertices[rows] + spread * torch.randn(count, 3, generator=generator)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_template_is_a_closed_solid(side: str) -> None:
    """The sign needs it: every edge twice, in opposite directions, and a positive volume."""
    mesh = trimesh.Trimesh(flat(side).numpy(), hand(side).faces.numpy(), process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 1e-4


def test_sdf_is_the_signed_distance_inside_the_band() -> None:
    point = near(flat(), 500)
    query = hand().sdf(flat(), point)
    want = closest_point(flat(), hand().faces, point, impl="reference").sdf
    torch.testing.assert_close(query.sdf, want.clamp(-0.05, 0.025), atol=1e-6, rtol=0)
    assert (query.sdf < 0).any()
    assert (query.sdf == 0.025).any()


@pytest.mark.parametrize("pose", ["fist", "point", "victory"])
@pytest.mark.parametrize("impl", ["tree", "reference"])
def test_what_is_within_a_finger_is_inside_wherever_the_fingers_pierce(pose: str, impl: Impl) -> None:
    """Beside skin that lies in other flesh: the closest feature alone calls a tenth of these points outside."""
    mesh = pose_hand(load_person().left_hand, torch.as_tensor(named_hand(pose, "left")).float(), torch.zeros(10))
    point = near(mesh, 600, 0.006)
    wound = winding_number(mesh.double(), hand().faces, point.double())
    query = hand().sdf(mesh, point, None, impl)
    feature = closest_point(mesh, hand().faces, point, impl=impl)
    assert torch.equal(query.sdf < 0, wound > 0.5)
    assert ((feature.sdf < 0) != (wound > 0.5)).sum() > 20
    torch.testing.assert_close(query.sdf.abs(), feature.sdf.abs(), atol=0, rtol=0)
    prepared = hand().sdf(mesh, point, None, surface=hand().surface(mesh))
    assert torch.equal(prepared.sdf < 0, query.sdf < 0)


@pytest.mark.parametrize(("pose", "share"), [("fist", 0.7), ("victory", 1.15), ("pinch", 1.0)])
def test_a_finger_tip_in_the_middle_of_a_large_face_is_found(pose: str, share: float) -> None:
    """All its corners are clear of the flesh; of 60 000 points some twenty would be called outside."""
    curled = torch.as_tensor(share * named_hand(pose, "left")).float()
    mesh = pose_hand(load_person().left_hand, curled, torch.zeros(10))
    surface = hand().surface(mesh)
    assert surface.tree is not None
    point = near(mesh, 60_000, 0.004)
    assert torch.equal(
        hand().sdf(mesh, point, None, surface=surface).sdf < 0,
        torch.from_numpy(winding(surface.tree, point.numpy()) > 0),
    )


def test_few_points_are_tested_one_by_one_and_buried_faces_looked_for_only_for_many() -> None:
    """Either way the signs are the same."""
    curled = torch.as_tensor(named_hand("fist", "left")).float()
    mesh = pose_hand(load_person().left_hand, curled, torch.zeros(10))
    surface = hand().surface(mesh)
    few = hand().sdf(mesh, near(mesh, 3000, 0.004), None, surface=surface).sdf
    assert "buried" not in surface.__dict__
    hand().sdf(mesh, near(mesh, 60_000, 0.004), None, surface=surface)
    assert "buried" in surface.__dict__
    assert len(surface.doubtful(torch.arange(len(hand().faces)))) < len(hand().faces)
    again = hand().sdf(mesh, near(mesh, 3000, 0.004), None, surface=surface).sdf
    assert torch.equal(few, again)


def test_an_open_hand_needs_hardly_any_winding_numbers() -> None:
    """Skin that is turned inside out in a crease, no more."""
    buried = hand().surface(flat()).buried
    assert buried.float().mean() < 0.02


def test_query_on_the_surface() -> None:
    """At vertices: distance 0, the vertex's own ω and normal."""
    rows = torch.arange(0, len(flat()), 40)
    query = hand().sdf(flat(), flat()[rows])
    assert query.sdf.abs().max() < 1e-6
    torch.testing.assert_close(hand().omega(query), hand().blend_weight[rows], atol=1e-4, rtol=0)
    torch.testing.assert_close(query.normal.norm(dim=-1), torch.ones(len(rows)))
    outward = hand().sdf(flat(), flat()[rows] + 1e-3 * query.normal).sdf
    assert (outward > 0).float().mean() > 0.98


def test_mirrored_hands_have_mirrored_distances() -> None:
    """The default person is symmetric to a fraction of a millimetre."""
    mirror = torch.tensor([-1.0, 1, 1])
    point = near(flat("left"), 300)
    left = hand("left").sdf(flat("left"), point).sdf
    right = hand("right").sdf(flat("right"), point * mirror).sdf
    assert (left - right).abs().median() < 1e-3


def test_colour_takes_points_or_a_query() -> None:
    point = near(flat(), 50, 0.002)
    pose = torch.zeros(15, 3)
    by_point = hand().colour(flat(), pose, point)
    torch.testing.assert_close(by_point, hand().colour(flat(), pose, hand().sdf(flat(), point)))
    assert by_point.shape == (50, 3)
    assert by_point.min() > 0
    assert by_point.max() < 1


def test_colour_follows_the_canonical_point_not_the_posed_one() -> None:
    """Moved with the mesh, a surface point keeps its colour; the pose itself may change it."""
    rows = torch.arange(0, len(flat()), 30)
    shift = torch.tensor([0.1, -0.2, 0.3])
    pose = torch.zeros(15, 3)
    here = hand().colour(flat(), pose, flat()[rows])
    there = hand().colour(flat() + shift, pose, flat()[rows] + shift)
    torch.testing.assert_close(here, there, atol=1e-3, rtol=0)
    bent = pose.clone()
    bent[0, 2] = 0.5
    assert (hand().colour(flat(), bent, flat()[rows]) - here).abs().max() > 1e-5


@pytest.mark.parametrize("preset", ["paper", "compact"])
def test_every_parameter_receives_a_gradient(preset: str) -> None:
    torch.manual_seed(0)
    field = HandField(load_person().left_hand, PRESETS[preset])
    field.colour(flat(), 0.3 * torch.randn(15, 3), near(flat(), 60)).square().sum().backward()
    for name, parameter in field.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name


def test_the_mlp_has_the_inputs_of_the_paper() -> None:
    field = HandField(load_person().left_hand, PRESETS["paper"])
    assert field.of_point.in_features + field.of_pose.in_features == 39 + 3 + 1 + 135


def test_far_and_extreme_inputs_stay_finite() -> None:
    point = torch.tensor([[1e4, 0, 0], [0, 0, 0], [-3.0, 2.0, 1.0]])
    pose = torch.full((15, 3), torch.pi)
    assert torch.isfinite(hand().colour(flat(), pose, point)).all()


def test_a_hand_of_any_size_has_a_surface() -> None:
    """Large and small faces with none in between, and all of them larger than what is queried apart."""
    for size in (0.5, 1.3, 1.5, 1.7, 2.0, 20.0):
        assert hand().surface(size * flat()).vertices.shape == flat().shape
