"""What a frame contains beside its picture, as arrays of the world: depth, normals, positions, coverage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from torch import Tensor

from avatarrex.frame import Frame


def passes(frame: Frame, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The named passes, float32, world space, metres, zero where the ray through the pixel's centre misses; and `hit`.

    depth (h, w) along the camera's axis; normal, position (h, w, 3); mask (h, w) coverage from 0 to 1.
    """
    points, world = frame.pointmap, frame.world_from_root
    hit = points.hit.cpu().numpy()
    rotation, translation = world[:3, :3], world[:3, 3]

    def seen(values: Tensor) -> np.ndarray:
        return values.double().cpu().numpy()

    made: dict[str, Callable[[], np.ndarray]] = {
        "depth": lambda: seen(points.depth) * hit,
        "normal": lambda: seen(points.normal) @ rotation.T * hit[..., None],
        "position": lambda: (seen(points.position) @ rotation.T + translation) * hit[..., None],
        "mask": lambda: seen(points.coverage),
    }
    return {**{name: made[name]().astype(np.float32) for name in names}, "hit": hit}
