"""The body grid prefiltered, so that what lies between its voxels is right on average and not too large where the body is round.

Linear interpolation of a distance s overestimates it between voxels of side h by h²/12 s″ on average along each axis: a limb of radius R
is drawn h²/12R too thin on every side, 0.7 mm of one of 5 cm by voxels of 2 cm, a ball twice that. Stored is

    s − Σ_axes (s₋₁ − 2s + s₁) / 12,

to second order the prefilter (−1/12, 7/6, −1/12) of linear quasi-interpolation along every axis (Blu and Unser, *Quantitative
Fourier analysis of approximation techniques*, 1999; Condat, Blu and Unser, *Beyond interpolation: optimal reconstruction by
quasi-interpolation*, 2005). The paper stores s.

Letters: z y x voxels. Metres, negative inside.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from avatarrex.volume.sdf_volume import BodyGrid

MOST = 0.1
"""Voxels by which a value changes at most, that of a limb of 1.7 cm by voxels of 2 cm: at creases s has no second derivative, and its
differences ask for more than is missing."""
LEAST = 1e-6
"""Metres that are left of a value whose sign would change: only cells that had a crossing are known at all corners (narrow_band.py)."""


def prefiltered(grid: BodyGrid) -> BodyGrid:
    """`grid` with the prefilter along every axis on which a voxel and both its neighbours were evaluated; bricks read the new values."""
    sdf = grid.sdf
    known = torch.ones_like(sdf, dtype=torch.bool) if grid.known is None else torch.from_numpy(grid.known)
    change = torch.zeros_like(sdf)
    for axis, size in enumerate(sdf.shape):
        if size < 3:
            continue
        below, here, above = (sdf.narrow(axis, k, size - 2) for k in range(3))
        whole = known.narrow(axis, 0, size - 2) & known.narrow(axis, 1, size - 2) & known.narrow(axis, 2, size - 2)
        change.narrow(axis, 1, size - 2).add_((below - 2 * here + above) * whole / 12)
    new = sdf - change.clamp(-MOST * grid.voxel, MOST * grid.voxel)
    new = torch.where((new < 0) == (sdf < 0), new, torch.where(sdf < 0, -LEAST, LEAST).to(sdf))
    bricks = grid.bricks.within(new) if grid.bricks else None
    return replace(grid, sdf=new, bricks=bricks)
