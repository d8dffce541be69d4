"""Trilinear interpolation on a regular grid, clamped at its border. Letters: p points, z y x voxels, c channels."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def trilinear(grid: Float[Tensor, "z y x c"], coordinate: Float[Tensor, "p 3"]) -> Float[Tensor, "p c"]:
    """Values at voxel coordinates (x, y, z), 0 at the first voxel's centre; keeps the coordinates' dtype."""
    size = torch.tensor(grid.shape[2::-1])
    place = coordinate.clamp(min=0).minimum((size - 1).to(coordinate.dtype))
    low = place.floor().long().minimum((size - 2).clamp(min=0))
    high = (low + 1).minimum(size - 1)
    t = place - low
    flat = grid.reshape(-1, grid.shape[3])
    result = coordinate.new_zeros(len(coordinate), grid.shape[3])
    for k in range(8):
        pick = [(high if k >> axis & 1 else low)[:, axis] for axis in range(3)]
        weight = torch.ones_like(t[:, 0])
        for axis in range(3):
            weight = weight * (t[:, axis] if k >> axis & 1 else 1 - t[:, axis])
        index = (pick[2] * grid.shape[1] + pick[1]) * grid.shape[2] + pick[0]
        result = result + weight[:, None] * flat[index].to(coordinate.dtype)
    return result
