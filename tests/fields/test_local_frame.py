import torch
from arm import LENGTH, arm_field, arm_frame, near, pose_arm

from avatarrex.fields.local_frame import NEIGHBOURS, Samples


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
    return Samples(rest, position, outward, back, owner, NEIGHBOURS, 0.015)


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


def test_the_vertex_frame_returns_vertices_to_rest_exactly():
    field = arm_field("vertex", dtype=torch.float64)
    bend = (0.2, 0.0, 1.5)
    posed = pose_arm(field.template, bend)
    found = arm_frame(field, bend).samples.rest_position(posed.vertices)
    torch.testing.assert_close(found, field.template.v_template, atol=1e-9, rtol=0)
