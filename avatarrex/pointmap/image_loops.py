"""Compiled loops (ops/native.py) between the pixels that the avatar covers and images: point_map.py, `CoveredPixels.scatter`.

Letters: h w image, p covered pixels, k parts. Arrays are float32 unless told.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import native

Array = Shaped[np.ndarray, "..."]
ZERO = np.float32(0)


class CoveredRows(NamedTuple):
    """Of each covered pixel."""

    position: Array
    """(p, 3)."""
    normal: Array
    """(p, 3)."""
    part_weight: Array
    """(p, k)."""
    hit: Array
    """(p,) bool."""
    coverage: Array
    """(p,)."""
    steps: Array
    """(p,)."""


class Images(NamedTuple):
    """As in a `PointMap`, with h·w rows."""

    position: Array
    normal: Array
    part_weight: Array
    hit: Array
    coverage: Array
    steps: Array
    depth: Array


@native
def scatter(begin: int, end: int, at: Array, rows: CoveredRows, axis: Array, images: Images) -> None:
    """All images of the pixels `begin : end`: of row at[pixel] (int32), zero where that is negative. `axis` (4,) float64: depth's
    row of the camera matrix.
    """
    for pixel in range(begin, end):
        k = at[pixel]
        if k < 0:
            for c in range(3):
                images.position[pixel, c] = images.normal[pixel, c] = ZERO
            for c in range(images.part_weight.shape[1]):
                images.part_weight[pixel, c] = ZERO
            images.hit[pixel] = False
            images.coverage[pixel] = images.steps[pixel] = images.depth[pixel] = ZERO
            continue
        for c in range(3):
            images.position[pixel, c], images.normal[pixel, c] = rows.position[k, c], rows.normal[k, c]
        for c in range(images.part_weight.shape[1]):
            images.part_weight[pixel, c] = rows.part_weight[k, c]
        images.hit[pixel], images.coverage[pixel], images.steps[pixel] = rows.hit[k], rows.coverage[k], rows.steps[k]
        x, y, z = np.float64(rows.position[k, 0]), np.float64(rows.position[k, 1]), np.float64(rows.position[k, 2])
        images.depth[pixel] = np.float32(x * axis[0] + y * axis[1] + z * axis[2] + axis[3])
