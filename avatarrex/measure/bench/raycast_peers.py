"""Where rays truly meet a stored volume, and the stored body grid by Mitsuba's `sdfgrid`, an independent renderer.

It reads the same trilinear cells (JCGT 11(3), 2022) and knows one grid: the parts' boxes are left out on both sides.
`scalar_rgb` needs no compiler and takes one ray at a time, so its time says little. Letters: r rays. Root frame, metres.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import torch

from avatarrex.camera import Camera
from avatarrex.measure.bench.contest import Contestant, timed
from avatarrex.measure.bench.session import Bench
from avatarrex.pointmap.raycast_reference import first_crossing
from avatarrex.pointmap.rays import RayPlane, Rays, pixel_centres
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume


def truth(volume: SdfVolume, camera: Camera) -> np.ndarray:
    """(r,) float64 t of every pixel's ray, +inf where it misses."""
    rays = RayPlane.of(camera, volume.middle).rays(pixel_centres(camera, torch.float64))
    return np.asarray(first_crossing(volume, rays))


def ray_error(t: np.ndarray, exact: np.ndarray) -> dict[str, Any]:
    """Of found t (r,), +inf where nothing was found, in millimetres along the rays that both hit."""
    found, hit = np.isfinite(t), np.isfinite(exact)
    error = 1e3 * np.abs(t[found & hit] - exact[found & hit])
    if not len(error):
        raise ArithmeticError("no ray hits: there is nothing to measure")
    return {
        "mean_error_mm": float(error.mean()),
        "p99_error_mm": float(np.quantile(error, 0.99)),
        "max_error_mm": float(error.max()),
        "missed": int(np.sum(hit & ~found)),
        "false": int(np.sum(found & ~hit)),
        "hits": int(hit.sum()),
    }


MITSUBA_PIXELS = 96
"""Pixels: Python's rays are slow."""


def distances(grid: BodyGrid, rays: Rays) -> np.ndarray:
    """(r,) t of each ray's first hit by Mitsuba, +inf where it misses; needs `mitsuba`."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    # Mitsuba 3.9 finds nothing in a grid of unequal sides: this one is made a cube, all outside where it was nothing.
    side = max(grid.sdf.shape)
    values = np.full((side, side, side, 1), float(grid.sdf.abs().max()), np.float32)
    values[tuple(slice(0, n) for n in grid.sdf.shape)] = grid.sdf.numpy()[..., None]
    size = grid.voxel * (side - 1.0)
    scene = mi.load_dict({"type": "scene", "shape": {"type": "sdfgrid", "grid": mi.TensorXf(values / size)}})
    # Its grid fills the unit cube; rays start just outside of it, where float32 has the most digits.
    entry = np.maximum(_entry(rays, grid.origin, size), rays.camera.numpy()) - 2 * grid.voxel
    direction = rays.direction.numpy()
    origin = (rays.origin.numpy() - grid.origin + np.where(np.isfinite(entry), entry, 0)[:, None] * direction) / size
    found = np.full(len(origin), np.inf)
    for k in np.flatnonzero(np.isfinite(entry)):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(origin[k].tolist(), direction[k].tolist()))
        if hit.is_valid():
            found[k] = entry[k] + hit.t * size
    return found


def _entry(rays: Rays, corner: np.ndarray, size: float) -> np.ndarray:
    """t at which each ray enters the cube, +inf where it misses it."""
    low, high = ((corner + side - rays.origin.numpy()) / rays.direction.numpy() for side in (0.0, size))
    entry, exit = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
    return np.where(entry < exit, entry, np.inf)


def add_mitsuba(bench: Bench, entries: list[Contestant], volume: SdfVolume, camera: Camera) -> None:
    """Append Mitsuba's entry on the body grid alone, where it is installed."""
    if find_spec("mitsuba") is None:
        bench.absent["peers.raycast.mitsuba_sdfgrid"] = "not installed: mitsuba"
        return
    small = camera.resized(bench.side(MITSUBA_PIXELS, MITSUBA_PIXELS), bench.side(MITSUBA_PIXELS, MITSUBA_PIXELS))
    alone = SdfVolume(volume.body)
    rays = RayPlane.of(small, alone.middle).rays(pixel_centres(small, torch.float64))
    found, took = timed(distances, volume.body, rays)
    error = ray_error(found, truth(alone, small))
    share = camera.width * camera.height / len(found)
    note = {"note": "body grid alone, one ray at a time from Python", "measured_rays": len(found)}
    entries.append(Contestant("mitsuba_sdfgrid", took.scaled(share), {**error, **note}))
