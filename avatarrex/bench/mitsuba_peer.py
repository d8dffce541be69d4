"""The stored body grid by Mitsuba's `sdfgrid`, an independent renderer of the same trilinear cells (JCGT 11(3), 2022).

It knows one grid: the parts' boxes are left out on both sides. `scalar_rgb` needs no compiler and takes one ray at a time, so
its time says little. Letters: r rays. Root frame, metres.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
import torch

from avatarrex.bench.clock import timed
from avatarrex.bench.peer import Contestant
from avatarrex.camera import Camera
from avatarrex.pointmap.raycast_reference import first_crossing
from avatarrex.pointmap.rays import RayPlane, Rays, pixel_centres
from avatarrex.volume.volume import BodyGrid, SdfVolume

if TYPE_CHECKING:
    from avatarrex.bench.session import Bench

SIDE = 96
"""Pixels: Python's rays are slow."""


def distances(grid: BodyGrid, rays: Rays) -> np.ndarray:
    """(r,) t of each ray's first hit by Mitsuba, +inf where it misses; needs `mitsuba`."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    size = grid.voxel * (np.array(grid.sdf.shape[::-1]) - 1.0)
    values = (grid.sdf.double().numpy() / size.max())[..., None].astype(np.float32)
    scene = mi.load_dict({"type": "scene", "shape": {"type": "sdfgrid", "grid": mi.TensorXf(values)}})
    # Mitsuba's grid fills the unit cube: rays are squeezed into it, and start just outside, where float32 has the most digits.
    entry = np.maximum(np.asarray(_entry(rays, grid, size)), np.asarray(rays.camera)) - 2 * grid.voxel
    direction = np.asarray(rays.direction) / size
    stretch = np.linalg.norm(direction, axis=1)
    origin = (np.asarray(rays.origin) - grid.origin) / size + np.where(np.isfinite(entry), entry, 0)[:, None] * direction
    direction /= stretch[:, None]
    found = np.full(len(origin), np.inf)
    for k in np.flatnonzero(np.isfinite(entry)):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(origin[k].tolist(), direction[k].tolist()))
        if hit.is_valid():
            found[k] = entry[k] + hit.t / stretch[k]
    return found


def _entry(rays: Rays, grid: BodyGrid, size: np.ndarray) -> torch.Tensor:
    """t at which each ray enters the grid's box, +inf where it misses it."""
    low = (torch.as_tensor(grid.origin) - rays.origin) / rays.direction
    high = (torch.as_tensor(grid.origin + size) - rays.origin) / rays.direction
    entry, exit = torch.minimum(low, high).amax(-1), torch.maximum(low, high).amin(-1)
    return torch.where(entry < exit, entry, torch.inf)


def add_mitsuba(bench: Bench, entries: list[Contestant], volume: SdfVolume, camera: Camera) -> None:
    """Append Mitsuba's entry on the body grid alone, where it is installed."""
    from avatarrex.bench.raycast import ray_error

    if find_spec("mitsuba") is None:
        bench.absent["peers.raycast.mitsuba_sdfgrid"] = "not installed: mitsuba"
        return
    small = camera.resized(bench.side(SIDE, SIDE), bench.side(SIDE, SIDE))
    alone = SdfVolume(volume.body)
    rays = RayPlane.of(small, alone.middle).rays(pixel_centres(small, torch.float64))
    found: list[np.ndarray] = []
    took = timed(lambda: found.append(distances(volume.body, rays)))
    error = ray_error(found[0], np.asarray(first_crossing(alone, rays)))
    share = camera.width * camera.height / len(found[0])
    note = {"note": "body grid alone, one ray at a time from Python", "measured_rays": len(found[0])}
    entries.append(Contestant("mitsuba_sdfgrid", took.scaled(share), {**error, **note}))
