"""Hand templates: closed, in the wrist frame, the body's own where the wrist alone carries it, ω where it belongs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from official import random_pose

from avatarrex.errors import InputError
from avatarrex.templates.hand import ELBOW, FIRST_FINGER, RAMP, WRIST, HandTemplate, cut_hand, pose_hand
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.person import load_person

SIDES = ("left", "right")


@pytest.fixture(params=SIDES, scope="module")
def hand(request: pytest.FixtureRequest) -> HandTemplate:
    return getattr(load_person(), f"{request.param}_hand")


@pytest.fixture(scope="module")
def body() -> TemplateModel:
    return load_person().body


def mesh(vertices: torch.Tensor, hand: HandTemplate) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices.numpy(), hand.model.faces.numpy(), process=False)


def test_closed_and_facing_out(hand: HandTemplate) -> None:
    solid = mesh(hand.model.v_template, hand)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.body_count == 1
    assert solid.euler_number == 2
    assert 3e-4 < solid.volume < 8e-4, "a hand with some forearm is about half a litre, and positive"
    assert solid.area_faces.min() > 1e-8
    assert set(np.unique(solid.faces)) == set(range(len(hand.blend_weight))), "no vertex without a triangle"


def test_still_closed_at_extreme_shapes(hand: HandTemplate) -> None:
    for sigma in (-5.0, 5.0):
        for k in range(10):
            solid = mesh(pose_hand(hand, torch.zeros(15, 3), sigma * torch.eye(10)[k]), hand)
            assert solid.volume > 5e-5, "never inside out"


def test_the_wrist_is_the_origin_whatever_the_shape(hand: HandTemplate) -> None:
    assert (hand.model.joint_template[0] == 0).all()
    assert (hand.model.joint_shapedirs[0] == 0).all()
    along = hand.model.v_template[:, 0] * (1 if hand.side == "left" else -1)
    assert -0.07 < along.min() < -0.045, "about 6 cm of forearm"
    assert 0.15 < along.max() < 0.25


def test_mano_order(hand: HandTemplate) -> None:
    fingers = ("index", "middle", "pinky", "ring", "thumb")
    wanted = [f"{hand.side}_wrist", *(f"{hand.side}_{finger}{k}" for finger in fingers for k in (1, 2, 3))]
    assert list(hand.model.joint_names) == wanted
    assert hand.model.parents == (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)


def test_the_hand_is_the_bodys_hand(hand: HandTemplate, body: TemplateModel) -> None:
    """Carried by the wrist's frame it is the posed body wherever no forearm joint has a share, in any shape."""
    rng = np.random.default_rng(0)
    pose, shape = torch.from_numpy(random_pose(rng)), torch.from_numpy(rng.uniform(-3, 3, 10))
    first = FIRST_FINGER[hand.side]
    posed = pose_template(body.double(), pose, shape, torch.zeros(52, dtype=torch.float64))
    exact = replace(hand, model=hand.model.double())
    local = pose_hand(exact, pose[first : first + 15], shape)
    frame = posed.joint_transforms[WRIST[hand.side]]
    placed = local @ frame[:3, :3].T + frame[:3, 3]
    own = body.weights[:, [WRIST[hand.side], *range(first, first + 15)]].sum(1)[hand.body_vertex_ids] > 1 - 1e-6
    own &= hand.body_vertex_ids >= 0
    assert own.sum() > 1400
    gap = (placed - posed.vertices[hand.body_vertex_ids]).norm(dim=1)
    assert gap[own].max() < 1e-6
    assert gap[~own & (hand.body_vertex_ids >= 0)].max() > 1e-3, "the stub is rigid with the wrist, the forearm is not"


def test_fists_do_not_move_the_stub(hand: HandTemplate) -> None:
    fist = pose_hand(hand, torch.full((15, 3), 0.8), torch.zeros(10))
    still = hand.blend_weight == 0
    assert (fist - hand.model.v_template)[still].abs().max() < 3e-3
    assert (fist - hand.model.v_template)[hand.body_vertex_ids < 0].abs().max() < 1e-6, "the cap stays"


def test_the_cap_is_where_the_weight_is_long_zero(hand: HandTemplate) -> None:
    omega, cap = hand.blend_weight, hand.body_vertex_ids < 0
    assert omega.min() == 0
    assert omega.max() == 1
    assert omega[cap].max() == 0
    rim = torch.unique(hand.model.faces[cap[hand.model.faces].any(1)])
    nearest = (hand.model.v_template[omega > 0][:, None] - hand.model.v_template[rim]).norm(dim=-1).min()
    assert nearest > 0.035, "the whole ramp lies on the hand's side of the cap, and further"
    distal = hand.model.weights[:, [3, 6, 9, 12, 15]].sum(1) > 0.5
    assert (omega[distal] == 1).all(), "fingertips are the hand's"


def test_the_ramp_is_smooth(hand: HandTemplate) -> None:
    """Along any edge ω changes by no more than 1.5 (smoothstep's slope) times its length over the ramp's width."""
    faces, v, omega = hand.model.faces, hand.model.v_template, hand.blend_weight
    edge = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    length = (v[edge[:, 0]] - v[edge[:, 1]]).norm(dim=1)
    change = (omega[edge[:, 0]] - omega[edge[:, 1]]).abs()
    assert (change <= 1.5 * length / (RAMP[1] - RAMP[0]) + 1e-5).all()
    assert ((omega > 0) & (omega < 1)).sum() > 50


@pytest.mark.parametrize("axis", range(3))
def test_the_two_meshes_agree_where_they_mix(hand: HandTemplate, body: TemplateModel, axis: int) -> None:
    """Wrist bent 60°: the hand is rigid with the wrist, the body follows the elbow. The mixed surface feels
    min(ω, 1−ω) of the difference; 2.7 mm were measured."""
    pose = torch.zeros(55, 3)
    pose[WRIST[hand.side], axis] = np.pi / 3
    posed = pose_template(body, pose, torch.zeros(10), torch.zeros(52))
    frame = posed.joint_transforms[WRIST[hand.side]]
    ids = hand.body_vertex_ids[:-1]
    placed = hand.model.v_template[:-1] @ frame[:3, :3].T + frame[:3, 3]
    gap = (placed - posed.vertices[ids]).norm(dim=1)
    omega = hand.blend_weight[:-1]
    assert (gap * torch.minimum(omega, 1 - omega)).max() < 3e-3


def test_hands_mirror() -> None:
    left, right = load_person().left_hand, load_person().right_hand
    assert len(left.blend_weight) == len(right.blend_weight)
    for a, b in (
        (left.model.v_template, right.model.v_template),
        (left.model.joint_template, right.model.joint_template),
    ):
        mirrored = b * b.new_tensor([-1.0, 1.0, 1.0])
        assert torch.cdist(a, mirrored).amin(1).max() < 2e-3
    assert abs(float(left.blend_weight.sum() - right.blend_weight.sum())) < 1


def test_finite_for_every_pose(hand: HandTemplate) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        posed = pose_hand(
            hand, torch.from_numpy(random_pose(rng, 15)).float(), torch.from_numpy(rng.uniform(-5, 5, 10)).float()
        )
        assert posed.isfinite().all()
        assert posed.norm(dim=1).max() < 0.6


def test_gradients(hand: HandTemplate) -> None:
    """The whole hand is large: one direction of the pose, by a numerical derivative."""
    exact = replace(hand, model=hand.model.double())
    rng = torch.Generator().manual_seed(0)
    pose, way = (torch.randn(15, 3, generator=rng, dtype=torch.float64) for _ in range(2))
    pose[3] = 0
    cotangent = torch.randn(len(hand.blend_weight), 3, generator=rng, dtype=torch.float64)

    def value(step: float) -> torch.Tensor:
        return (pose_hand(exact, pose + step * way, torch.zeros(10, dtype=torch.float64)) * cotangent).sum()

    pose.requires_grad_()
    (gradient,) = torch.autograd.grad(value(0.0), pose)
    with torch.no_grad():
        numerical = (value(1e-5) - value(-1e-5)) / 2e-5
    assert abs((gradient * way).sum() - numerical) < 1e-6 * abs(numerical)


def test_pose_blend_shapes_of_the_fingers_come_along(body: TemplateModel) -> None:
    """Of 486 pose directions a hand keeps the 135 of its own fingers."""
    rng = torch.Generator().manual_seed(0)
    full = replace(body, posedirs=torch.randn(len(body.weights), 3, 486, generator=rng).mul(1e-4), pose_columns=None)
    pose = torch.randn(55, 3, generator=rng)
    for side in SIDES:
        hand, first = cut_hand(full, side), FIRST_FINGER[side]
        assert hand.model.posedirs.shape[2] == 135
        fingers = torch.zeros_like(pose)
        fingers[first : first + 15] = pose[first : first + 15]
        posed = pose_template(full, fingers, torch.zeros(10), torch.zeros(52))
        own = hand.blend_weight == 1
        local = posed.vertices[hand.body_vertex_ids] - full.joint_template[WRIST[side]]
        assert (pose_hand(hand, pose[first : first + 15], torch.zeros(10)) - local)[own].abs().max() < 1e-5


def test_nan_is_refused(hand: HandTemplate) -> None:
    with pytest.raises(InputError, match="pose"):
        pose_hand(hand, torch.full((15, 3), torch.nan), torch.zeros(10))


def test_a_body_without_a_forearm_is_refused(body: TemplateModel) -> None:
    """All faces of the arm gone: nothing to cut. A second hole in the palm: two loops, one sentence."""
    arm = body.weights[:, [ELBOW["left"], WRIST["left"]]].sum(1) > 0.1
    with pytest.raises(InputError, match="left hand"):
        cut_hand(replace(body, faces=body.faces[~arm[body.faces].any(1)][:10]), "left")
    palm = load_person().left_hand
    hole = (palm.model.v_template[palm.body_vertex_ids >= 0] - torch.tensor([0.09, 0.0, 0.0])).norm(dim=1).argmin()
    keep = (body.faces != palm.body_vertex_ids[hole]).all(1)
    with pytest.raises(InputError, match="one open loop"):
        cut_hand(replace(body, faces=body.faces[keep]), "left")
