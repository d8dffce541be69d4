"""Antialiased silhouettes: the share of a pixel that is covered."""

import numpy as np
import pytest
import torch

from avatarrex.camera import Camera
from avatarrex.gl.context import gl_unavailable
from avatarrex.pointmap import raycast_gl
from avatarrex.pointmap.raycast import raycast
from avatarrex.reference.solids import body_grid, capsule, sphere, union
from avatarrex.volume.sdf_volume import SdfVolume

BALL = SdfVolume(body_grid(sphere((0.3, 0.3, 0.3), 0.2), (0, 0, 0), 0.02, (31, 31, 31)))


def view(size, azimuth=0.0):
    return Camera.orbit(azimuth, 0, 2.0, 20, (0.3, 0.3, 0.3), size, size)


def test_a_ball_covers_its_disc(impl):
    one = raycast(BALL, view(48), impl)
    focal = 24 / np.tan(np.radians(10))
    disc = np.pi * focal**2 * 0.2**2 / (2.0**2 - 0.2**2)
    # 150 silhouette pixels, each right to about 1/16 and unbiased; the grid takes 0.25 % off the radius.
    assert abs(float(one.coverage.sum()) - disc) < 0.006 * disc
    partial = (one.coverage > 0) & (one.coverage < 1)
    assert 80 < int(partial.sum()) < 300
    assert torch.equal(one.coverage * 16, (one.coverage * 16).round())


def test_silhouettes_do_not_depend_on_where_tiles_begin(impl):
    whole = raycast(BALL, view(48), impl).coverage
    for left, top in ((1, 0), (0, 1), (3, 5)):
        cut = raycast(BALL, view(48).cropped(left, top, 40, 40), impl).coverage
        apart = (cut - whole[top : top + 40, left : left + 40]).abs()
        assert apart.max() <= 1 / 16
        assert (apart > 0).sum() <= 3


def test_a_level_rod_is_smoothed_above_and_below(impl):
    """Every pixel of its rims has neighbours to both sides that are hit."""
    rod = SdfVolume(body_grid(capsule((0.0, 0.3, 0.3), (0.6, 0.3, 0.3), 0.085), (0, 0, 0), 0.02, (31, 31, 31)))
    middle = raycast(rod, view(48), impl).coverage[:, 18:30]
    partial = ((middle > 0) & (middle < 1)).float().mean(1)
    assert (partial == 1).nonzero()[:, 0].tolist() == (partial.flip(0) == 1).nonzero()[:, 0].tolist()
    assert int((partial == 1).sum()) == 2


def test_without_antialiasing_coverage_is_the_hit(impl):
    one = raycast(BALL, view(48), impl, antialias=False)
    assert torch.equal(one.coverage > 0, one.hit)
    assert torch.equal(one.coverage, one.hit.float())


def test_hits_do_not_depend_on_antialiasing(impl, man):
    camera = Camera.orbit(20, 10, 2.6, 40, (0, 0, 0), 40, 40)
    one, two = raycast(man, camera, impl), raycast(man, camera, impl, antialias=False)
    assert torch.equal(one.hit, two.hit)
    assert torch.equal(one.position[one.hit], two.position[two.hit])


def test_a_partly_covered_pixel_has_a_point_to_shade(impl):
    one = raycast(BALL, view(48), impl)
    borrowed = (one.coverage > 0) & ~one.hit
    assert borrowed.sum() > 20
    assert ((one.position[borrowed] - 0.3).norm(dim=-1) - 0.2).abs().max() < 1e-3
    torch.testing.assert_close(one.normal[borrowed].norm(dim=-1), torch.ones(int(borrowed.sum())))
    assert (one.depth[borrowed] > 1.5).all()
    assert (one.coverage[one.hit] > 0).all()


def test_coverage_agrees_with_a_supersampled_image(impl, man):
    """A quarter of the pixel size gives the same sub-positions as pixel centres."""
    camera = Camera.orbit(-30, 5, 0.9, 40, (-0.6, 0.3, 0), 40, 40)
    one = raycast(man, camera, impl).coverage
    fine = raycast(man, camera.resized(160, 160), impl, antialias=False).hit.float()
    expected = torch.nn.functional.avg_pool2d(fine[None, None], 4)[0, 0]
    # Sub-positions are marched, not walked exactly: single ones may differ where they graze.
    assert (one - expected).abs().max() <= 2 / 16 + 1e-6
    assert (one != expected).float().mean() < 0.01


def test_a_rod_thinner_than_a_pixel_does_not_vanish(impl):
    volume = SdfVolume(body_grid(capsule((0.1, 0.3, 0.3), (0.5, 0.3, 0.3), 0.015), (0, 0, 0), 0.01, (61, 61, 61)))
    pixel = 2 * 2.0 * np.tan(np.radians(10)) / 12
    cameras = [Camera.orbit(0, 0, 2.0, 20, (0.3, 0.3 + k * pixel / 4, 0.3), 12, 12) for k in range(4)]
    maps = [raycast(volume, camera, impl) for camera in cameras]
    covered = np.array([float(one.coverage.sum()) for one in maps])
    hits = np.array([int(one.hit.sum()) for one in maps])
    # 3 cm at 5.9 cm a pixel: the rod lies between two rows of centres, or takes one.
    assert hits.min() == 0
    assert hits.max() >= 6
    area = (0.4 * 0.03 + np.pi * 0.015**2) / pixel**2
    np.testing.assert_allclose(covered, area, rtol=0.1)


def test_more_silhouettes_than_there_is_room_for_are_not_smoothed(monkeypatch, man):
    """A surface that is nothing but edges loses subpixels, never pixels."""
    camera = Camera.orbit(20, 10, 2.6, 40, (0, 0, 0), 40, 40)
    whole, hard = (raycast(man, camera, "gl", antialias=smooth) for smooth in (True, False))
    monkeypatch.setattr(raycast_gl, "_slots", lambda camera, antialias: 60 if antialias else 0)
    few = raycast(man, camera, "gl")
    assert torch.equal(few.hit, whole.hit)
    smoothed = few.coverage != hard.coverage
    assert 10 < int(smoothed.sum()) <= 60  # occlusion edges take some
    assert torch.equal(few.coverage[smoothed], whole.coverage[smoothed])
    assert few.counters["rays"] == 40 * 40 + 16 * 60


def rods(lift, behind=True):
    """A level rod, and one behind it whose rims are seen beside those of the first, but for `lift` metres."""
    near = capsule((0.1, 0.3, 0.45), (0.5, 0.3, 0.45), 0.085)
    far = capsule((0.1, 0.3 + lift, 0.13), (0.5, 0.3 + lift, 0.13), 0.0997)
    return SdfVolume(body_grid(union(near, far) if behind else near, (0, 0, 0), 0.02, (31, 31, 31)))


@pytest.mark.parametrize("lift", [-0.012, -0.004, 0.004, 0.012])
def test_a_rim_behind_a_rim_covers_its_share(impl, lift):
    """Where the pixel's own ray has passed the first, its sub-rays go on to the second."""
    volume, camera = rods(lift), view(40)
    one = raycast(volume, camera, impl).coverage
    hits = raycast(volume, camera.resized(160, 160), impl, antialias=False).hit.float()
    expected = torch.nn.functional.avg_pool2d(hits[None, None], 4)[0, 0]
    assert (one - expected).abs().max() <= 1 / 16
    assert (one != expected).float().mean() < 0.005


@pytest.mark.skipif(gl_unavailable() is not None, reason=f"no OpenGL: {gl_unavailable()}")
def test_sub_rays_end_where_their_pixel_is_free_again():
    """8.6 samples a sub-ray, 10.0 to the end of the grid."""
    whole, centres = (raycast(rods(0, behind=False), view(40), "gl", smooth).counters for smooth in (True, False))
    assert whole["ray_steps"] - centres["ray_steps"] < 9.3 * (whole["rays"] - centres["rays"])
