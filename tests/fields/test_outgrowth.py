"""What stands off the template: a ball at rest, carried along by the vertices next to it."""

import numpy as np
import pytest
import torch

from avatarrex.fields.outgrowth import DEVIATION, MARGIN, VOXEL, Outgrowth, PosedOutgrowth
from avatarrex.fields.template_distance import AIR, TemplateDistance

CENTRE, RADIUS = np.array([0.1, 0.1, 0.08]), 0.03


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
