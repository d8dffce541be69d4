"""Key light and sky through a distance field: closed forms, and the shader against its reference."""

import numpy as np
import pytest
import torch
from stage.solid_volume import banded

from avatarrex.reference.solids import rotation, sphere
from avatarrex.stage.distance import distance_grid
from avatarrex.stage.visibility import Cone, available, visibility

UP = torch.tensor([0.0, 1.0, 0.0])
RADIUS, HEIGHT = 0.1, 0.3
BALL = distance_grid(banded(sphere((0.0, 0.0, 0.0), RADIUS)))
ABOVE = Cone(np.array([0.0, 1.0, 0.0]), 0.07)


def floor(x, height=HEIGHT):
    """Points of a floor under the ball, `x` metres beside its middle."""
    x = torch.as_tensor(x, dtype=torch.float32)
    return torch.stack([x, torch.full_like(x, -height), torch.zeros_like(x)], -1)


@pytest.fixture(params=available())
def impl(request):
    return request.param


def test_a_ball_throws_a_shadow_with_a_half_shade(impl):
    """By a light of tangent w from h above, the half-shade is h w to both sides of the ball's outline."""
    points = floor([0.0, 0.06, RADIUS, 0.14, 0.3])
    key = visibility(BALL, points, UP.expand_as(points), ABOVE, 0.003, impl)[:, 0]
    assert key[0] == 0
    assert key[1] < 0.06
    assert key[2] == pytest.approx(0.5, abs=0.12)
    assert key[3] > 0.9
    assert key[4] == 1


def test_a_wider_light_has_a_wider_half_shade(impl):
    points = floor(torch.linspace(0.04, 0.18, 57))
    spans = []
    for width in (0.04, 0.12):
        key = visibility(BALL, points, UP.expand_as(points), Cone(ABOVE.direction, width), 0.003, impl)[:, 0]
        assert (key.diff() > -0.03).all(), "it grows outwards, but for the grid"
        spans.append(int(((key > 0.05) & (key < 0.95)).sum()))
    assert spans[1] > 2 * spans[0]


def test_the_sky_that_a_ball_hides(impl):
    """cos θ (R / d)² of the cosine-weighted sky, within a tenth of the sky: nine cones are not the hemisphere."""
    places = np.array([0.0, 0.1, 0.2, 0.35])
    points = floor(places)
    sky = visibility(BALL, points, UP.expand_as(points), ABOVE, 0.003, impl)[:, 1].numpy()
    away = places**2 + HEIGHT**2
    assert np.abs(sky - (1 - RADIUS**2 * HEIGHT / away**1.5)).max() < 0.1
    assert (np.diff(sky) > 0).all()


def test_a_surface_does_not_shade_itself(impl):
    """The lit half of the ball sees the whole light, and where it turns away none; nothing hides its sky."""
    angle = torch.linspace(0, 3.1, 40)
    normals = torch.stack([angle.sin(), angle.cos(), 0 * angle], -1)
    seen = visibility(BALL, RADIUS * normals, normals, ABOVE, 0.012, impl)
    cosine = normals[:, 1]
    assert (seen[cosine > 0.4, 0] > 0.98).all()
    assert (seen[cosine < -0.2, 0] == 0).all()
    assert (seen[:, 1] > 0.9).all()


def test_nothing_depends_on_where_up_is(impl):
    turn = rotation(0, 40.0) @ rotation(2, 25.0)
    points = floor(torch.linspace(0, 0.3, 30))
    upright = visibility(BALL, points, UP.expand_as(points), ABOVE, 0.003, impl)
    turned = points @ torch.from_numpy(turn.T).float()
    normals = (torch.from_numpy(turn).float() @ UP).expand_as(points)
    key = Cone(turn @ ABOVE.direction, ABOVE.width)
    assert (visibility(BALL, turned, normals, key, 0.003, impl)[:, 0] - upright[:, 0]).abs().max() < 0.15


@pytest.mark.skipif("gl" not in available(), reason="needs OpenGL 4.3")
def test_the_shader_has_the_reference_s_steps():
    rng = np.random.default_rng(1)
    points = torch.from_numpy(rng.uniform(-0.6, 0.6, (3000, 3))).float()
    normals = torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(3000, 3))).float(), dim=-1)
    direction = np.array([0.4, 0.8, -0.45])
    key = Cone(direction / np.linalg.norm(direction), 0.08)
    made = {impl: visibility(BALL, points, normals, key, 0.003, impl) for impl in ("reference", "gl")}
    apart = (made["reference"] - made["gl"]).abs()
    assert apart.max() < 2e-3
    assert made["gl"].std(0).min() > 0.03, "some see it, some do not"
    assert visibility(BALL, points[:0], normals[:0], key, 0.003, "gl").shape == (0, 2)
