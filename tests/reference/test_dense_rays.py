"""Dense samples along rays against closed forms: spheres, thin plates, cameras inside and far away."""

import math

import numpy as np
import pytest
import torch
from pointmap.dense_solid import DenseSolid

from avatarrex.camera import Camera
from avatarrex.pointmap.rays import RayPlane, Rays, pixel_centres
from avatarrex.reference.dense_rays import EXACT, dense_crossing
from avatarrex.reference.solids import capsule, slab, sphere, union


def rays_of(camera: Camera) -> Rays:
    return RayPlane.of(camera, np.zeros(3)).rays(pixel_centres(camera, torch.float64))


@pytest.mark.parametrize("distance", [1.5, 20.0])
def test_a_sphere_is_met_where_its_equation_says(distance: float) -> None:
    fov = math.degrees(2 * math.atan(0.5 / distance))
    rays = rays_of(Camera.orbit(30, 20, distance, fov, (0, 0, 0), 24, 24))
    t = dense_crossing(DenseSolid(sphere((0, 0, 0), 0.3)), rays, 0.001)
    middle = -(rays.origin * rays.direction).sum(-1)
    squared = 0.09 - rays.at(middle).square().sum(-1)
    assert (squared > 0).sum() > 100
    assert torch.equal(t.isfinite(), squared > 0)
    hit = squared > 0
    assert (t - (middle - squared.clamp(min=0).sqrt()))[hit].abs().max() < 2 * EXACT


def test_a_plate_thicker_than_the_step_is_never_missed_and_a_thinner_one_can_be() -> None:
    rays = rays_of(Camera.orbit(0, 0, 1.5, 20, (0, 0, 0), 24, 24))
    plate = DenseSolid(slab(0.1, 0.1011, axis=2))
    found = dense_crossing(plate, rays, 0.001)
    assert found.isfinite().all()
    torch.testing.assert_close(rays.at(found)[:, 2], torch.full((576,), 0.1011).double(), rtol=0, atol=2 * EXACT)
    assert not dense_crossing(plate, rays, 0.02).isfinite().all()


def test_the_first_of_two_surfaces_is_met() -> None:
    rays = rays_of(Camera.orbit(0, 0, 1.5, 20, (0, 0, 0), 16, 16))
    bar = capsule((-1, 0.01, 0.45), (1, 0.01, 0.45), 0.02)
    t = dense_crossing(DenseSolid(union(sphere((0, 0, 0), 0.4), bar)), rays, 0.001)
    front = dense_crossing(DenseSolid(bar), rays, 0.001)
    assert front.isfinite().sum() > 10
    torch.testing.assert_close(t[front.isfinite()], front[front.isfinite()], rtol=0, atol=2 * EXACT)


def test_a_camera_inside_leaves_first() -> None:
    rays = rays_of(Camera.orbit(0, 0, 0.2, 20, (0, 0, 0), 8, 8))
    assert not dense_crossing(DenseSolid(sphere((0, 0, 0), 0.3)), rays, 0.001).isfinite().any()
    beyond = union(sphere((0, 0, 0), 0.3), sphere((0, 0, -0.6), 0.2))
    t = dense_crossing(DenseSolid(beyond), rays, 0.001)
    assert t.isfinite().all()
    assert (rays.at(t)[:, 2] < -0.35).all()
