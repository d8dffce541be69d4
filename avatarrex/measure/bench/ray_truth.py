"""Where rays truly meet a stored volume, and how far a ray caster is from it. Letters: r rays. Metres."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from avatarrex.camera import Camera
from avatarrex.pointmap.raycast_reference import first_crossing
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.volume.sdf_volume import SdfVolume


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
