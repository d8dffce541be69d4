"""What stands off the template: a ball at rest, carried along by the vertices next to it."""

import numpy as np
import pytest
import torch

from avatarrex.fields.body import BodyField
from avatarrex.fields.local_frame import Samples
from avatarrex.fields.outgrowth import DEVIATION, MARGIN, VOXEL, Outgrowth, PosedOutgrowth
from avatarrex.fields.presets import COMPACT
from avatarrex.fields.slide import JOINTS
from avatarrex.fields.template_distance import AIR, TemplateDistance
from avatarrex.ops.skinning import skin
from avatarrex.templates.model import PosedTemplate, pose_template
from avatarrex.templates.person import load_person

CENTRE, RADIUS = np.array([0.1, 0.1, 0.08]), 0.03
HEAD, LONG = 15, 0.26


def ball(rest: np.ndarray) -> Outgrowth:
    low = np.floor((CENTRE - RADIUS - MARGIN) / VOXEL).astype(int)
    size = np.ceil(2 * (RADIUS + MARGIN) / VOXEL).astype(int)
    place = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), -1)[..., ::-1] + low
    distance = np.linalg.norm(place * VOXEL - CENTRE, axis=-1) - RADIUS
    found = Outgrowth(torch.from_numpy(low), torch.from_numpy(distance).float())
    found.lay(torch.from_numpy(rest))
    return found


def plane() -> np.ndarray:
    """21² vertices, 1 cm apart, z = 0."""
    x, y = np.meshgrid(np.arange(21), np.arange(21), indexing="ij")
    return 0.01 * np.stack([x, y, 0 * x], -1).reshape(-1, 3).astype(float)


def moved() -> tuple[PosedOutgrowth, TemplateDistance, np.ndarray, np.ndarray]:
    """The ball on a plane that was turned by 40° and shifted."""
    rest, angle = plane(), np.radians(40)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    shift = np.array([0.3, -0.2, 0.5])
    posed = rest @ turn.T + shift
    own = ball(rest)
    carried = own.carried(posed, np.tile(turn, (len(own.carrier), 1, 1)))
    normals = np.tile(turn[:, 2], (len(rest), 1))
    nothing = np.zeros(len(rest))
    return carried, TemplateDistance.of(posed, normals, nothing, nothing, outgrowth=carried), turn, shift


def test_the_ball_moves_with_the_skin_beneath_it() -> None:
    carried, skin, turn, shift = moved()
    rng = np.random.default_rng(0)
    rest = CENTRE + rng.normal(0, 0.03, (500, 3))
    here = skin.query(rest @ turn.T + shift)
    true = np.linalg.norm(rest - CENTRE, axis=1) - RADIUS
    near = true < 0.6 * np.abs(rest[:, 2])  # nearer than the plane
    assert near.sum() > 200
    np.testing.assert_allclose(
        here.guess[near], true[near], atol=0.007
    )  # the ball's middle is the tip of a cone, which a grid of 8 mm cuts
    assert (here.deviation[near] == DEVIATION).all()
    np.testing.assert_allclose(carried.points.mean(0), CENTRE @ turn.T + shift, atol=VOXEL)


def test_what_hangs_on_a_joint_moves_as_it_does() -> None:
    """Though the skin beneath stays: the end of a pony tail lies at the back."""
    carried, skin, turn, shift = moved()
    posed = np.eye(4)
    posed[:3, :3], posed[:3, 3] = turn, shift
    rest = plane()
    still = ball(rest).hung(len(rest), posed)
    nothing = np.zeros(len(rest))
    skin = TemplateDistance.of(rest, np.tile([0.0, 0, 1], (len(rest), 1)), nothing, nothing, outgrowth=still)
    points = CENTRE + np.random.default_rng(0).normal(0, 0.02, (200, 3))
    true = np.linalg.norm(points - CENTRE, axis=1) - RADIUS
    here = skin.query(points @ turn.T + shift)
    np.testing.assert_allclose(here.guess, true, atol=0.007)
    np.testing.assert_allclose(still.points, carried.points, atol=1e-12)


def test_anchors_lie_on_the_surface_and_face_outwards() -> None:
    own = ball(plane()).hanging_on(3, 0.015)
    assert own.anchor is not None
    place = own.anchor.double().numpy()
    away = place - CENTRE
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), RADIUS, atol=1e-3)
    np.testing.assert_allclose(own.outward(place), away / np.linalg.norm(away, axis=1, keepdims=True), atol=0.05)
    apart = np.linalg.norm(place[:, None] - place, axis=2) + np.eye(len(place))
    assert 0.01 < apart.min() < apart.min(1).max() < 0.022
    assert len(place) == pytest.approx(4 * np.pi * RADIUS**2 / 0.015**2, rel=0.35)


@pytest.fixture(scope="module")
def tail() -> tuple[BodyField, BodyField, Outgrowth]:
    """A body with a pony tail of 32 cm on its head's joint, 2 cm off neck and back, and one without; cloth slides on both, which stand 5 mm
    higher."""
    model = load_person().body
    bare, own = (BodyField(model, COMPACT).requires_grad_(False) for _ in range(2))
    top = model.joint_template[HEAD].double().numpy() + np.array([0.0, 0.07, -0.15])
    low = np.floor((top - np.array([0, LONG, 0]) - RADIUS - MARGIN) / VOXEL).astype(int)
    size = np.ceil((2 * (RADIUS + MARGIN) + np.array([LONG, 0, 0])) / VOXEL).astype(int)  # z y x
    size = size[[1, 0, 2]]
    place = (np.stack(np.meshgrid(*[np.arange(n) for n in size], indexing="ij"), -1)[..., ::-1] + low) * VOXEL
    along = place - top
    along[..., 1] -= along[..., 1].clip(-LONG, 0)
    distance = np.linalg.norm(along, axis=-1) - RADIUS
    hung = Outgrowth(torch.from_numpy(low), torch.from_numpy(distance).float()).hanging_on(HEAD, 0.025)
    own.set_outgrowth(hung)
    for one in (bare, own):
        one.raise_surface(torch.full((len(one.sample_anchor),), 0.005))
        one.add_slide(torch.full((len(one.node_vertex), JOINTS), 0.02))
    return bare, own, hung


def turned(field: BodyField) -> tuple[PosedTemplate, Samples]:
    """With the head turned to a side: the tail stays off the shoulder."""
    pose = torch.zeros(55, 3)
    pose[HEAD] = torch.tensor([0.0, 0.25, 0.0])
    posed = pose_template(field.template, pose, torch.zeros(10), torch.zeros(field.template.expression_dirs.shape[2]))
    return posed, field.frame(posed, field.code(torch.eye(3).expand(21, 3, 3))).samples


def onto(posed: PosedTemplate, rest: torch.Tensor) -> torch.Tensor:
    """As the head moves them."""
    return skin(posed.skinning[HEAD].float()[:3].expand(len(rest), 3, 4), rest)


@pytest.mark.parametrize("impl", ["auto", "torch"])
def test_what_hangs_on_a_joint_has_its_own_rest_positions(
    tail: tuple[BodyField, BodyField, Outgrowth], impl: str
) -> None:
    """To its end, next to skin that stays; without anchors it is centimetres off there."""
    bare, own, hung = tail
    rest = torch.from_numpy(hung.points()).float()
    posed, samples = turned(own)
    moved = onto(posed, rest)
    beside = samples.neighbours_of(moved, impl)
    torch.testing.assert_close(samples.rest_position(moved, beside), rest, atol=1e-4, rtol=0)
    torch.testing.assert_close(samples.painted_position(moved, beside), rest, atol=1e-4, rtol=0)
    before = turned(bare)[1].rest_position(moved)
    assert (before - rest).norm(dim=1).amax() > 0.03


def test_the_skin_beneath_it_keeps_its_own(tail: tuple[BodyField, BodyField, Outgrowth]) -> None:
    """But for what is within it."""
    bare, own, hung = tail
    posed, samples = turned(own)
    before, head = turned(bare)[1], posed.skinning[HEAD].double().numpy()
    count = len(before.rest)
    assert len(samples.rest) == count + len(hung.anchor if hung.anchor is not None else [])
    assert torch.equal(samples.rest_from_posed[:count], before.rest_from_posed)
    assert samples.slide is not None
    assert before.slide is not None
    assert torch.equal(samples.slide[:count], before.slide)
    assert before.slide.norm(dim=1).median() > 1e-4
    assert not samples.slide[count:].any()
    vertices = posed.vertices.double().numpy()
    away = hung.hung(len(vertices), head).distance(vertices, np.arange(len(vertices)))
    near = (away > 0.01) & (away < 0.05)
    here = posed.vertices[torch.from_numpy(near)].float()
    kept = before.rest_position(here)
    assert len(here) > 50
    for impl in ("auto", "torch"):
        found = samples.rest_position(here, samples.neighbours_of(here, impl))
        assert (found - kept).norm(dim=1).amax() < 0.003
    owned = torch.zeros(own.widths.nodes, dtype=torch.bool)
    owned[samples.owner[count:]] = True
    some = samples.among(owned)
    assert count > len(some.rest) > len(samples.rest) - count
    moved = onto(posed, torch.from_numpy(hung.points()).float())
    torch.testing.assert_close(some.rest_position(moved), samples.rest_position(moved), atol=1e-5, rtol=0)


def test_what_no_joint_carries_and_avatars_of_before_have_no_anchors() -> None:
    field = BodyField(load_person().body, COMPACT).requires_grad_(False)
    skin_alone = field.sample_rest.clone()
    loose = ball(plane())
    for one in (loose, Outgrowth(loose.first, loose.distance, torch.tensor(HEAD)), None):
        field.set_outgrowth(one)
        assert torch.equal(field.sample_rest, skin_alone)
    field.set_outgrowth(loose.hanging_on(HEAD, 0.02))
    again = BodyField(load_person().body, COMPACT)
    again.load_state_dict(field.state_dict())
    for name in ("sample_rest", "sample_normal", "sample_weights", "sample_owner", "sample_gate_rest"):
        assert torch.equal(getattr(again, name), getattr(field, name))
    assert len(again.sample_rest) > len(skin_alone)


def test_what_is_nearer_counts_and_the_field_keeps_to_it() -> None:
    _, skin, turn, shift = moved()
    points = np.array([CENTRE, [0.1, 0.1, -0.01], [0.02, 0.02, 0.01]]) @ turn.T + shift
    here = skin.query(points)
    assert here.guess.tolist() == pytest.approx([-RADIUS, -0.01, 0.01], abs=0.007)
    low, high = here.clamped(torch.full((3,), -1.0)), here.clamped(torch.full((3,), 1.0))
    assert float(low[0]) == pytest.approx(here.guess[0] - DEVIATION)
    assert float(high[0]) == pytest.approx(here.guess[0] + AIR * DEVIATION)


def test_some_of_the_skin_carries_its_own() -> None:
    _, skin, turn, shift = moved()
    half = np.arange(len(skin.vertices)) % 2 == 0
    point = CENTRE[None] @ turn.T + shift
    assert skin.of_vertices(half, 0.04).query(point).guess[0] == pytest.approx(-RADIUS, abs=0.007)


def test_the_extent_has_room_for_it() -> None:
    _, skin, turn, shift = moved()
    height = (skin.extent - shift) @ turn
    assert height[:, 2].max() == pytest.approx(CENTRE[2] + RADIUS, abs=VOXEL)
