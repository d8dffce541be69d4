import math

import numpy as np
import pytest
import torch
from arm import LENGTH, arm_field, arm_frame, near, pose_arm

from avatarrex.fields.body import BodyField
from avatarrex.fields.local_frame import NEIGHBOURS, Samples
from avatarrex.fields.presets import COMPACT
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.crossings import winding
from avatarrex.ops.search_tree import SearchTree
from avatarrex.signals.library import named_pose
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import load_person

LOST = 0.1
"""Share of such points with a rest position outside."""
TAKEN = {"crossed_arms": 0.029, "hands_on_hips": 0.02}
"""And about hands that touch."""


def two_limbs(gap: float) -> Samples:
    """Two straight rows of anchors along x: at rest 1 m apart, posed `gap` apart."""
    x = torch.arange(20) * 0.02
    row = torch.stack([x, torch.zeros(20), torch.zeros(20)], -1)
    rest = torch.cat([row, row + torch.tensor([0.0, 1.0, 0.0])])
    position = torch.cat([row, row + torch.tensor([0.0, gap, 0.0])])
    eye = torch.eye(3).expand(40, 3, 3)
    back = torch.cat([eye, (rest - position)[:, :, None]], -1)
    owner = torch.arange(40) // 20
    outward = torch.tensor([[0.0, 1, 0], [0, -1, 0]])[owner]
    return Samples(rest, position, outward, back, owner, 0.015)


def test_another_limb_does_not_mix_in():
    """A point just on this side of the middle belongs wholly to this limb, whatever touches it."""
    gap = 0.02
    samples = two_limbs(gap)
    here = samples.rest_position(torch.tensor([[0.19, 0.4 * gap, 0.0]]))
    there = samples.rest_position(torch.tensor([[0.19, 0.6 * gap, 0.0]]))
    torch.testing.assert_close(here, torch.tensor([[0.19, 0.4 * gap, 0.0]]), atol=1e-6, rtol=0)
    torch.testing.assert_close(there, torch.tensor([[0.19, 1 - 0.4 * gap, 0.0]]), atol=1e-6, rtol=0)


def test_among_searches_only_owned_samples():
    samples = two_limbs(0.02).among(torch.tensor([False, True]))
    assert len(samples.rest) == 20
    found = samples.rest_position(torch.tensor([[0.19, 0.001, 0.0]]))
    torch.testing.assert_close(found, torch.tensor([[0.19, 0.981, 0.0]]), atol=1e-6, rtol=0)


def test_nearest_against_all_distances():
    samples = two_limbs(0.3)
    points = torch.rand(300, 3, generator=torch.Generator().manual_seed(0)) * 0.4
    expected = torch.cdist(points.double(), samples.position.double()).topk(NEIGHBOURS, largest=False)
    found = (points[:, None] - samples.position[samples.nearest(points)]).norm(dim=-1)
    torch.testing.assert_close(found.double(), expected.values, atol=1e-6, rtol=0)
    assert samples.nearest(torch.zeros(0, 3)).shape == (0, NEIGHBOURS)


def test_rest_position_of_a_bent_arm():
    """Away from the bend both bones are rigid: p̄ is known exactly. The anchors must find it."""
    field = arm_field(dtype=torch.float64)
    bend = (0.0, 0.0, 1.3)
    posed = pose_arm(field.template, bend)
    frame = arm_frame(field, bend)
    rest = near(pose_arm(field.template, (0.0, 0.0, 0.0)), 400, spread=0.01)
    lower = rest[:, 0] > 0.75 * LENGTH
    upper = rest[:, 0] < 0.25 * LENGTH
    a = posed.skinning[1]
    moved = torch.where(lower[:, None], rest @ a[:3, :3].T + a[:3, 3], rest)
    found = frame.samples.rest_position(moved)
    rigid = lower | upper
    assert rigid.sum() > 150
    # weights of the far bone there: sigmoid(−0.2/0.03) = 0.13 %, of neighbours 5 cm on 0.7 %; lever 0.2 m
    assert (found - rest)[rigid].norm(dim=-1).max() < 2e-3


def test_a_point_in_one_limb_that_touches_another_belongs_to_the_one_it_is_in():
    """11 mm deep in the lower limb, and by a sample 17 mm aside only 5 mm above the upper one's skin."""
    rest = torch.tensor([[0.0, 0, 0], [0.02, 0, 0], [0, 0, 1], [0.01, 0, 1], [0.02, 0, 1.0]])
    point = torch.tensor([[0.0, 0, -0.011]])
    position = torch.tensor([[0.008, 0, 0], [0.02, 0, 0], [0.017, 0, -0.016], [0.03, 0, -0.016], [0.04, 0, -0.016]])
    outward = torch.tensor([[0.0, 0, 1]]).expand(5, 3)
    back = torch.cat([torch.eye(3).expand(5, 3, 3), (rest - position)[:, :, None]], -1)
    samples = Samples(rest, position, outward, back, torch.tensor([0, 0, 1, 1, 1]), 0.015)
    for impl in ("auto", "torch"):
        weight = samples.neighbours_of(point, impl).weight[0]
        mine = samples.neighbours_of(point, impl).index[0] < 2
        assert weight[mine].sum() == 1, impl
        assert weight[~mine].max() == 0, impl


@pytest.mark.parametrize("degrees", [0, 90, 140])
def test_a_turned_frame_keeps_distances_about_a_sharp_elbow(degrees):
    """A sample's blended matrix shrinks by cos θ/2, a third at 140°, and its inverse stretches as much."""
    angle = math.radians(degrees)
    bend = (0.0, 0.0, angle)
    stretch = {}
    for name in ("turned", "anchors"):
        back = arm_frame(arm_field(name, dtype=torch.float64), bend).samples.rest_from_posed[:, :, :3]
        stretch[name] = torch.linalg.svdvals(back).amax()
    assert abs(stretch["turned"] - 1) < 1e-12
    assert stretch["anchors"] > 0.65 / math.cos(angle / 2)


def lost(pose: torch.Tensor, joints: list[int], reach: float) -> float:
    """Share of points inside the default person's union, within `reach` of joints, with a rest position outside."""
    person = load_person().body
    posed = pose_template(person, pose, torch.zeros(10), torch.zeros(person.expression_dirs.shape[2]))
    mesh, rng = posed.vertices.double().numpy(), np.random.default_rng(0)
    around = posed.joints.double().numpy()[joints]
    about = mesh[(np.linalg.norm(mesh[:, None] - around, axis=2) < reach).any(1)]
    points = about[rng.integers(len(about), size=6000)] + 0.015 * rng.normal(size=(6000, 3))
    deep = closest_point(posed.vertices.double(), person.faces, torch.from_numpy(points)).sdf.abs().numpy() > 0.003
    tree = SearchTree.of_triangles(mesh, person.faces.numpy())
    inside = points[deep & (winding(tree, points) > 0)]
    assert len(inside) > 1000
    field = BodyField(person, COMPACT).requires_grad_(False)
    frame = field.frame(posed, field.code(torch.eye(3).expand(21, 3, 3)))
    rest = frame.samples.rest_position(torch.as_tensor(inside, dtype=torch.float32))
    outside = closest_point(person.v_template.double(), person.faces, rest.double()).sdf > 0
    return float(outside.double().mean())


def test_sharply_bent_limbs_of_the_default_person_stay_whole():
    """About elbows bent by 140° and knees by 115°."""
    pose = torch.zeros(55, 3)
    pose[18, 1], pose[19, 1], pose[4, 0], pose[5, 0] = -math.radians(140), math.radians(140), 2.0, 2.0
    assert lost(pose, [4, 5, 18, 19], 0.14) < LOST


@pytest.mark.parametrize("name", TAKEN)
def test_a_hand_does_not_take_the_flesh_it_lies_on(name):
    """A hand is thin: what it touches is far below the plane of its back, and not in it."""
    pose = torch.zeros(55, 3)
    pose[1:22] = torch.tensor(np.array(named_pose(name)), dtype=torch.float32)
    assert lost(pose, [20, 21], 0.16) < TAKEN[name]
