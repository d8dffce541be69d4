"""Where samples go on a ray, and that what they see does not move a surface that is right."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from avatarrex.camera import Camera
from avatarrex.pointmap.rays import RayPlane, Rays
from avatarrex.reference.solids import body_grid, sphere, union
from avatarrex.training.core.losses import mask_loss, rgb_loss, silhouette_loss
from avatarrex.training.core.sampling import Walk, draw, noise_of
from avatarrex.training.core.volume_rendering import render_weights
from avatarrex.volume.sdf_volume import SdfVolume

MIDDLE = (0.3, 0.3, 0.3)
RADIUS = 0.2
GAMMA = 5e-4
CAMERA = Camera.orbit(20, 10, 1.5, 25, MIDDLE, 96, 96)


def stored(radius: float) -> SdfVolume:
    """A ball in a volume of 2 cm."""
    return SdfVolume(body_grid(sphere(MIDDLE, radius), (0, 0, 0), 0.02, (31, 31, 31)))


def distance(points: torch.Tensor) -> torch.Tensor:
    """To the ball's middle."""
    return (points - torch.tensor(MIDDLE)).norm(dim=-1)


def rays_of(count: int) -> tuple[RayPlane, Rays]:
    """Rays all over the picture."""
    plane = RayPlane.of(CAMERA, np.array(MIDDLE))
    return plane, plane.rays(96 * torch.rand(count, 2, generator=torch.Generator().manual_seed(3)))


@pytest.mark.parametrize("gamma", [GAMMA, 5e-3])
def test_samples_of_a_ray_that_meets_the_surface_end_inside(gamma):
    _, rays = rays_of(3000)
    walked = Walk(stored(RADIUS), rays)
    samples = draw(walked, "near", 5, gamma, noise_of(0, 1))
    point = rays.origin[:, None] + samples.t[..., None] * rays.direction[:, None]
    depth = distance(point) - RADIUS
    through = walked.lowest[1] < -0.03
    assert through.sum() > 500
    assert (samples.t.diff(dim=-1) >= 0).all()
    assert samples.used[through].all()
    assert (depth[through, -1] < -0.004).all()
    assert (depth[through, 0] > -0.01).all()


def test_rays_that_graze_a_limb_see_what_is_behind_it():
    """An arm before the torso: a few millimetres beside it fog of 4 mm takes the arm for opaque."""
    arm, torso = ((0.3, 0.3, 0.45), 0.045), ((0.3, 0.3, 0.2), 0.15)
    volume = SdfVolume(body_grid(union(sphere(*arm), sphere(*torso)), (0, 0, 0), 0.02, (31, 31, 31)))
    camera = Camera.orbit(0, 0, 1.5, 20, (0.3, 0.3, 0.3), 96, 96)
    place = 30 + 36 * torch.rand(4000, 2, generator=torch.Generator().manual_seed(3))
    rays = RayPlane.of(camera, np.array(MIDDLE)).rays(place)

    def closest(ball: tuple[tuple[float, ...], float]) -> torch.Tensor:
        along = ((torch.tensor(ball[0]) - rays.origin) * rays.direction).sum(-1)
        return (rays.at(along) - torch.tensor(ball[0])).norm(dim=-1) - ball[1]

    grazes = (closest(arm) > 0.002) & (closest(arm) < 0.008) & (closest(torso) < -0.05)
    assert grazes.sum() > 50
    samples = draw(Walk(volume, rays), "near", 5, GAMMA, noise_of(0, 1))
    last = rays.at(samples.t[:, -1])[grazes]
    assert ((last - torch.tensor(torso[0])).norm(dim=-1) < torso[1] - 0.004).all()


def test_rays_past_the_surface_are_not_sampled():
    _, rays = rays_of(3000)
    walked = Walk(stored(RADIUS), rays)
    far = walked.lowest[1] > 0.08
    assert far.sum() > 100
    assert not draw(walked, "near", 5, GAMMA, noise_of(0, 1)).used[far].any()


def test_the_lowest_point_of_a_ray_is_found_between_candidates():
    _, rays = rays_of(3000)
    t, depth = Walk(stored(RADIUS), rays).lowest
    nearest = distance(rays.at(((torch.tensor(MIDDLE) - rays.origin) * rays.direction).sum(-1))) - RADIUS
    rim = nearest.abs() < 0.03
    assert rim.sum() > 200
    assert float((distance(rays.at(t)) - RADIUS - nearest)[rim].abs().max()) < 2e-4
    assert float((depth - nearest)[rim].abs().max()) < 3e-3


@pytest.mark.parametrize("stale", [-0.006, 0.0, 0.006])
def test_the_losses_are_least_at_the_true_surface(stale):
    """Whatever the stored surface is: samples that all lie outside pull it out, by 3 mm where the stored one is 6 mm out."""
    plane, rays = rays_of(4000)
    walked = Walk(stored(RADIUS + stale), rays)
    samples = draw(walked, "near", 5, GAMMA, noise_of(0, 1))
    point = rays.origin[:, None] + samples.t[..., None] * rays.direction[:, None]
    t, _ = walked.lowest
    width = plane.footprint * (1 - t / rays.camera)
    along = ((torch.tensor(MIDDLE) - rays.origin) * rays.direction).sum(-1)
    beside = distance(rays.at(along))
    matte = (0.5 - (beside - RADIUS) / width).clamp(0, 1)
    hit = along - (RADIUS**2 - beside.square()).clamp_min(0).sqrt()

    def colour(points: torch.Tensor) -> torch.Tensor:
        return 0.5 + 0.5 * torch.sin(40 * points)

    truth = colour(rays.at(hit)) * matte[:, None]
    one = torch.ones(len(t))

    def loss(radius: float) -> float:
        sdf = distance(point) - radius
        last = (samples.used.sum(1) - 1).clamp_min(0)[:, None]
        sdf = torch.where(samples.used, sdf, 1.0).gather(1, torch.arange(sdf.shape[1]).minimum(last))
        weight, opacity = render_weights(sdf, samples.t, GAMMA)
        seen = (weight[..., None] * colour(point)).sum(1)
        silhouette = silhouette_loss(distance(rays.at(t)) - radius, width, matte, one).value
        return float(rgb_loss(seen, truth, one).value + mask_loss(opacity, matte, one).value + 2 * silhouette)

    tried = torch.linspace(-0.004, 0.004, 81)
    found = tried[int(np.argmin([loss(RADIUS + float(change)) for change in tried]))]
    assert abs(float(found)) <= 5e-4
