"""The body grid and its bricks prefiltered, so that what lies between voxels is right on average, not too large where the body is round.

Linear interpolation of a distance s overestimates it between voxels of side h by h²/12 s″ on average along each axis: a limb of radius R
is drawn h²/12R too thin on every side, 0.7 mm of one of 5 cm by voxels of 2 cm, a ball twice that. Stored is

    s − Σ_axes (s₋₁ − 2s + s₁) / 12,

to second order the prefilter (−1/12, 7/6, −1/12) of linear quasi-interpolation along every axis (Blu and Unser, *Quantitative
Fourier analysis of approximation techniques*, 1999; Condat, Blu and Unser, *Beyond interpolation: optimal reconstruction by
quasi-interpolation*, 2005). The paper stores s.

Letters: z y x voxels, m bricks, n corners along one. Metres, negative inside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from avatarrex.volume.bricks import Bricks
from avatarrex.volume.sdf_volume import BodyGrid

MOST = 0.1
"""Voxels by which a value changes at most, that of a limb of 1.7 cm by voxels of 2 cm: at creases s has no second derivative, and its
differences ask for more than is missing."""
LEAST = 1e-6
"""Metres that are left of a value whose sign would change: only cells that had a crossing are known at all corners (narrow_band.py)."""


def prefiltered(grid: BodyGrid) -> BodyGrid:
    """`grid` and its bricks with the prefilter along every axis on which a voxel and both its neighbours were evaluated."""
    known = torch.ones_like(grid.sdf, dtype=torch.bool) if grid.known is None else torch.from_numpy(grid.known)
    change = torch.zeros_like(grid.sdf)
    for axis in range(3):
        change += _missing(_padded(grid.sdf, axis), _padded(known, axis), axis)
    new = _stored(grid.sdf, change, grid.voxel)
    if grid.bricks is None:
        return replace(grid, sdf=new)
    return replace(grid, sdf=new, bricks=grid.bricks.storing(_in_bricks(grid.bricks, grid.voxel), new.numpy()))


def _in_bricks(bricks: Bricks, voxel: float) -> Float32[np.ndarray, "m n n n"]:
    """What bricks of a grid of `voxel` metres store at their corners."""
    value, change = torch.from_numpy(bricks.value), torch.zeros(bricks.value.shape)
    for axis in range(3):
        around, known = (torch.from_numpy(bricks.extended(one, axis)) for one in (bricks.value, bricks.known))
        change += _missing(around, known, axis + 1)
    return _stored(value, change, voxel / bricks.side).numpy()


def _padded(values: Tensor, axis: int) -> Tensor:
    """With zeros at both ends of an axis."""
    end = torch.zeros_like(values.narrow(axis, 0, 1))
    return torch.cat([end, values, end], axis)


def _missing(around: Tensor, known: Tensor, axis: int) -> Tensor:
    """A twelfth of the second differences along an axis of what has a voxel more at both of its ends; 0 where one of three is not known."""
    count = around.shape[axis] - 2
    below, here, above = (around.narrow(axis, k, count) for k in range(3))
    low, middle, high = (known.narrow(axis, k, count) for k in range(3))
    return (below - 2 * here + above) * (low & middle & high) / 12


def _stored(sdf: Tensor, change: Tensor, voxel: float) -> Tensor:
    """`sdf` less the change, within limits."""
    new = sdf - change.clamp(-MOST * voxel, MOST * voxel)
    return torch.where((new < 0) == (sdf < 0), new, torch.where(sdf < 0, -LEAST, LEAST).to(sdf))
