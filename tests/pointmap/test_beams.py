"""Rays of a tile share the free part of their way (shaders/pointmap/beams.comp): nothing may be lost by it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from raycast_cases import errors, reference

from avatarrex.camera import Camera
from avatarrex.gl.context import gl_context, gl_unavailable
from avatarrex.pointmap.raycast import raycast
from avatarrex.pointmap.raycast_gl import GlCaster
from avatarrex.reference.solids import body_grid, capsule, sphere
from avatarrex.volume.sdf_volume import SdfVolume

pytestmark = pytest.mark.skipif(gl_unavailable() is not None, reason=f"no OpenGL: {gl_unavailable()}")
CAMERAS = {
    "an odd size": Camera.orbit(20, 10, 2.6, 40, (0, -0.05, 0), 101, 77),
    "less than a tile": Camera.orbit(20, 10, 2.6, 40, (0, -0.05, 0), 7, 5),
    "few pixels": Camera.orbit(-40, 0, 2.6, 40, (0, -0.05, 0), 24, 24),
    "a long lens": Camera.orbit(80, 5, 40.0, 3, (0, -0.05, 0), 64, 64),
    "a wide one": Camera.orbit(150, 30, 0.8, 110, (0, 0.2, 0), 64, 64),
    "among the limbs": Camera.orbit(0, 0, 0.3, 90, (0.3, -0.5, 0), 64, 64),
    "a person at the rim": Camera.orbit(20, 0, 2.0, 30, (0.9, 0.5, 0), 64, 64),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_beams_lose_nothing(man: SdfVolume, name: str) -> None:
    camera = CAMERAS[name]
    one, other = raycast(man, camera, "gl"), raycast(man, camera, "torch")
    assert torch.equal(one.hit, other.hit)
    assert errors(one, reference(man, camera))[1:] == (0, 0)
    # Sub-positions that graze are marched from elsewhere: single ones differ.
    assert (one.coverage - other.coverage).abs().sum() < 0.015 * other.coverage.sum() + 1 / 16


def test_a_rod_is_found_wherever_it_lies_in_a_tile() -> None:
    rod = SdfVolume(body_grid(capsule((0.1, 0.3, 0.3), (0.5, 0.33, 0.3), 0.015), (0, 0, 0), 0.01, (61, 61, 61)))
    for k in range(24):
        camera = Camera.orbit(0, 0, 2.0, 20, (0.3 + 0.003 * k, 0.3 + 0.011 * k, 0.3), 48, 48)
        one, other = raycast(rod, camera, "gl"), raycast(rod, camera, "torch")
        assert torch.equal(one.hit, other.hit), k
        np.testing.assert_allclose(one.coverage.sum(), other.coverage.sum(), rtol=0.03)
        assert (one.coverage - other.coverage).abs().max() <= 4 / 16, k


@pytest.mark.parametrize("distance", [0.25, 0.5, 2.0])
def test_a_steep_field_is_not_stepped_through(man: SdfVolume, distance: float) -> None:
    """A learned field may exceed the distance: a beam that trusted it came out behind the limb."""
    steep, found = SdfVolume(replace(man.body, sdf=1.4 * man.body.sdf)), 0
    for target in ((0, 0.1, 0), (0.1, -0.5, 0), (0.3, 0.3, 0)):
        camera = Camera.orbit(15, 5, distance, 40, target, 96, 96)
        one, other = raycast(steep, camera, "gl"), raycast(steep, camera, "torch")
        assert not (
            other.hit & ~one.hit
        ).any()  # where a march steps through, a beam may find the surface: not the other way
        both = one.hit & other.hit
        assert not both.any() or (one.depth - other.depth)[both].abs().quantile(0.99) < 1e-5
        found += int(both.sum())
    assert found > 300


def test_empty_tiles_cost_no_step(man: SdfVolume) -> None:
    away = raycast(man, Camera.orbit(20, 10, 2.6, 40, (0, 9, 0), 64, 64), "gl")
    assert away.counters["ray_steps"] == 0
    assert not away.hit.any()
    ball = SdfVolume(body_grid(sphere((0.3, 0.3, 0.3), 0.02), (0, 0, 0), 0.02, (31, 31, 31)))
    camera = Camera.orbit(0, 0, 2.0, 20, (0.3, 0.3, 0.3), 64, 64)
    one, other = (raycast(ball, camera, impl, antialias=False) for impl in ("gl", "torch"))
    assert one.counters["ray_steps"] < 0.3 * other.counters["ray_steps"]
    assert one.hit.sum() > 10


def test_a_picture_after_a_larger_one_holds_nothing_of_it(man: SdfVolume) -> None:
    """Pixels of empty tiles are not written: what was there before would be silhouettes of another view."""
    near, far = Camera.orbit(20, 10, 1.0, 60, (0, 0, 0), 64, 64), Camera.orbit(20, 10, 9.0, 40, (0, 0, 0), 64, 64)
    fresh = GlCaster(gl_context())
    alone = fresh.cast(man, far, antialias=True)
    fresh.cast(man, near, antialias=True)
    after = fresh.cast(man, far, antialias=True)
    assert torch.equal(after.hit, alone.hit)
    assert after.counters["rays"] == alone.counters["rays"] < 64 * 64 * 3
    assert np.isfinite(fresh.distances(far)).sum() == alone.hit.sum() > 0
