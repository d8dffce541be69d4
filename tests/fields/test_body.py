from dataclasses import replace

import pytest
import torch
from arm import TINY, arm_field, arm_frame, arm_model, near, pose_arm, rotations

from avatarrex.errors import InputError
from avatarrex.fields.body import BodyField
from avatarrex.fields.code import BodyCode
from avatarrex.fields.influence import RADIUS
from avatarrex.fields.local_frame import LOCAL_FRAMES
from avatarrex.ops.local_mlp import DIFFERENTIABLE
from avatarrex.ops.rotation import matrix_from_rotvec

FRAMES = pytest.mark.parametrize("local_frame", LOCAL_FRAMES)
BEND = (0.0, 0.4, 0.9)


def surface(field, frame, points):
    view = torch.nn.functional.normalize(torch.ones_like(points), dim=-1)
    return field.sdf(frame, points), field.colour(frame, field.patches(frame), points, view)


@FRAMES
def test_a_rigid_motion_changes_nothing(local_frame):
    """The whole arm and the points turn about the shoulder together: same distances, same colours."""
    field = arm_field(local_frame, dtype=torch.float64)
    turn = (0.7, -0.4, 1.1)
    still, moved = arm_frame(field, BEND), arm_frame(field, BEND, turn)
    points = near(pose_arm(field.template, BEND), 80)
    matrix = matrix_from_rotvec(torch.tensor(turn, dtype=torch.float64))
    view = torch.nn.functional.normalize(torch.ones_like(points), dim=-1)
    torch.testing.assert_close(field.sdf(moved, points @ matrix.T), field.sdf(still, points), atol=1e-9, rtol=1e-7)
    patches = field.patches(still)
    colours = [field.colour(frame, patches, p, view) for frame, p in ((moved, points @ matrix.T), (still, points))]
    torch.testing.assert_close(*colours, atol=1e-9, rtol=1e-7)


@FRAMES
def test_order_of_the_nodes_does_not_matter(local_frame):
    field, other = arm_field(local_frame, dtype=torch.float64), arm_field(local_frame, dtype=torch.float64)
    order = torch.tensor([3, 0, 6, 2, 5, 1, 4])
    per_node = ("geometry_local.", "patch_network.", "colour_local.", "node_vertex")
    state = {k: v[order] if k.startswith(per_node) else v for k, v in field.state_dict().items()}
    other.load_state_dict(state)
    assert torch.equal(other.node_rest, field.node_rest[order]), "loading places the nodes anew"
    code = field.code(rotations(dtype=torch.float64))
    posed = pose_arm(field.template, BEND)
    frame = field.frame(posed, code)
    permuted = other.frame(posed, BodyCode(code.residual[order], code.embedding[order]))
    points = near(posed, 60)
    for mine, theirs in zip(surface(field, frame, points), surface(other, permuted, points)):
        torch.testing.assert_close(theirs, mine, atol=1e-10, rtol=1e-9)


@FRAMES
@pytest.mark.parametrize("impl", DIFFERENTIABLE[1:])
def test_implementations_agree_in_value_and_gradient(local_frame, impl):
    field = arm_field(local_frame, dtype=torch.float64)
    points = near(pose_arm(field.template, BEND), 40).requires_grad_()
    view = torch.nn.functional.normalize(torch.ones_like(points), dim=-1).detach()
    results = []
    for which in ("reference", impl):
        frame = arm_frame(field, BEND)
        sdf = field.sdf(frame, points, impl=which)
        colour = field.colour(frame, field.patches(frame), points, view, impl=which)
        leaves = [points, *(p for n, p in field.named_parameters() if ".encoder." not in n)]
        gradients = torch.autograd.grad(sdf.sum() + colour.square().sum(), leaves)
        results.append((sdf, colour, *gradients))
    for got, want in zip(*results):
        torch.testing.assert_close(got, want, atol=1e-10, rtol=1e-9)


@FRAMES
def test_gradients_by_finite_differences(local_frame):
    field = arm_field(local_frame, dtype=torch.float64)
    frame = arm_frame(field, BEND)
    points = near(pose_arm(field.template, BEND), 4).requires_grad_()
    view = torch.nn.functional.normalize(torch.ones_like(points), dim=-1).detach()
    patches = field.patches(frame).detach()

    def of_points(p):
        return field.sdf(frame, p), field.colour(frame, patches, p, view)

    # 1e-7 m: no point crosses a border between nearest vertices
    assert torch.autograd.gradcheck(of_points, points, eps=1e-7, atol=1e-5, rtol=1e-4)


def test_gradients_of_the_code_by_finite_differences():
    field = arm_field(dtype=torch.float64)
    posed = pose_arm(field.template, BEND)
    points = near(posed, 5)
    start = field.code(rotations(dtype=torch.float64))
    residual, embedding = (t.detach().requires_grad_() for t in (start.residual, start.embedding))

    def of_code(residual, embedding):
        return surface(field, field.frame(posed, BodyCode(residual, embedding)), points)

    assert torch.autograd.gradcheck(of_code, (residual, embedding), eps=1e-6, atol=1e-6, rtol=1e-4)


def test_second_derivatives_for_the_eikonal_term():
    field = arm_field(dtype=torch.float64)
    frame = arm_frame(field, BEND)
    points = near(pose_arm(field.template, BEND), 30).requires_grad_()
    (gradient,) = torch.autograd.grad(field.sdf(frame, points).sum(), points, create_graph=True)
    loss = (gradient.norm(dim=-1) - 1).square().mean()
    loss.backward()
    for name, parameter in field.geometry_local.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name


@FRAMES
@pytest.mark.parametrize("angle", [2.97, 3.1, 3.14159265, -3.14159265])
def test_opposed_twists_stay_finite(local_frame, angle):
    field = arm_field(local_frame)
    twist = (angle, 0.0, 0.0)
    frame = arm_frame(field, twist)
    points = near(pose_arm(field.template, twist), 500).requires_grad_()
    sdf, colour = surface(field, frame, points)
    assert sdf.abs().max() < 1
    assert colour.isfinite().all()
    (gradient,) = torch.autograd.grad(sdf.sum() + colour.sum(), points)
    assert gradient.isfinite().all()


@FRAMES
def test_no_points(local_frame):
    field = arm_field(local_frame)
    frame = arm_frame(field)
    nothing = torch.zeros(0, 3)
    sdf, colour = surface(field, frame, nothing)
    assert sdf.shape == (0,)
    assert colour.shape == (0, 3)
    assert field.pairs(frame, nothing).offsets.tolist() == [0] * 8


@FRAMES
def test_far_points_get_the_conservative_fill(local_frame):
    field = arm_field(local_frame)
    frame = arm_frame(field, (0.0, 0.0, 0.0))
    far = torch.tensor([[0.4, 3.0, 0.0], [0.4, 0.0, -0.5], [1e4, 0.0, 0.0]])
    sdf, colour = surface(field, frame, far)
    true = torch.tensor([2.95, 0.45, 1e4 - 0.8])
    assert (sdf > 0).all(), "zero there would be a false near miss"
    assert (sdf < true).all(), "more than the true distance overshoots"
    assert (sdf > true - RADIUS - 0.1).all()
    torch.testing.assert_close(sdf, field.outside_distance(frame, far))
    assert colour.isfinite().all()


def test_fill_never_exceeds_the_distance_to_the_surface():
    """The mutant without the covering radius must fail here."""
    field = arm_field()
    posed = pose_arm(field.template, BEND)
    frame = field.frame(posed, field.code(rotations()))
    points = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 0.7
    reach = torch.cdist(points, frame.node_position).amin(1)
    outside = points[reach > RADIUS]
    true = torch.cdist(outside, posed.vertices).amin(1)
    assert len(outside) > 500
    assert (field.outside_distance(frame, outside) <= true).all()
    assert (field.outside_distance(frame, outside) + frame.cover > true).any()


def test_local_frames_agree_at_rest():
    """At rest every reading gives p̄ = p."""
    for name in LOCAL_FRAMES:
        field = arm_field(name, dtype=torch.float64)
        frame = arm_frame(field, (0.0, 0.0, 0.0))
        points = near(pose_arm(field.template, (0.0, 0.0, 0.0)), 50)
        pairs, local, weight = field.localise(frame, points, field.pairs(frame, points))
        expected = points[pairs.point] - frame.node_rest[pairs.node]
        torch.testing.assert_close(local, expected, atol=1e-7, rtol=0)  # skinning weights sum to 1 ± 6e-8
        assert (weight > 0).all()


def test_among_is_blind_to_the_other_nodes():
    """Half of the arm: moving the other half changes nothing, and its region counts as outside."""
    field = arm_field(preset=replace(TINY, body=replace(TINY.body, nodes=20)))
    upper = field.node_rest[:, 0] < 0.3
    code = field.code(rotations())
    straight = pose_arm(field.template, (0.0, 0.0, 0.0))
    hand = (straight.vertices[:, :1] > 0.5) * torch.tensor([-0.5, 0.08, 0.0])
    touching = replace(straight, vertices=straight.vertices + hand)
    points = near(straight, 200)
    values = []
    for posed in (straight, touching):
        frame = replace(field.frame(posed, code), cover=torch.tensor(0.1))
        values.append([field.sdf(frame.restricted(mask), points) for mask in (upper, None)])
    torch.testing.assert_close(values[0][0], values[1][0], atol=0, rtol=0)
    assert (values[0][1] - values[1][1]).abs().max() > 0.01, "the whole field does feel the hand"
    frame = field.frame(straight, code)
    torch.testing.assert_close(field.sdf(frame.restricted(torch.ones_like(upper)), points), field.sdf(frame, points))
    nobody = field.sdf(frame.restricted(torch.zeros_like(upper)), points)
    assert (nobody == torch.inf).all(), "no node, no surface"


def test_a_shape_or_pose_corrected_template_carries_the_field():
    """Vertices displaced by anything but skinning take nodes and rest positions with them."""
    field = arm_field(dtype=torch.float64)
    posed = pose_arm(field.template, (0.0, 0.0, 0.0))
    code = field.code(rotations(dtype=torch.float64))
    shift = torch.tensor([0.0, 0.03, 0.0], dtype=torch.float64)
    points = near(posed, 50)
    still = field.sdf(field.frame(posed, code), points)
    shifted = field.frame(replace(posed, vertices=posed.vertices + shift), code)
    torch.testing.assert_close(field.sdf(shifted, points + shift), still, atol=1e-10, rtol=1e-9)


def test_half_precision_storage_moves_the_surface_by_less_than_a_tenth_of_a_millimetre():
    field, stored = arm_field(), arm_field()
    halves = {k: v.half().float() if v.is_floating_point() else v for k, v in field.state_dict().items()}
    stored.load_state_dict(halves)
    points = near(pose_arm(field.template, BEND), 2000, spread=0.005)
    apart = field.sdf(arm_frame(field, BEND), points) - stored.sdf(arm_frame(stored, BEND), points)
    assert 0 < apart.abs().max() < 1e-4


def test_cutoff_changes_colours_by_less_than_it_drops():
    fine = arm_field(preset=replace(TINY, body=replace(TINY.body, colour_cutoff=0.0)))
    coarse = arm_field(preset=replace(TINY, body=replace(TINY.body, colour_cutoff=0.05)))
    coarse.load_state_dict(fine.state_dict())
    points = near(pose_arm(fine.template, BEND), 300)
    colours = [surface(f, arm_frame(f, BEND), points)[1] for f in (fine, coarse)]
    assert 0 < (colours[0] - colours[1]).abs().max() < 0.05


def test_unknown_local_frame_is_refused():
    with pytest.raises(InputError, match="local_frame: expected anchors or turned, found linear"):
        BodyField(arm_model(), TINY, 0, "linear")
