"""A solid as the pipeline stores it: exact in a narrow band, lower bounds elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from avatarrex.reference.solids import Solid, body_grid
from avatarrex.volume.sdf_volume import SdfVolume

VOXEL = 0.02
ORIGIN = (-0.4, -0.4, -0.4)


def banded(solid: Solid, side: int = 41) -> SdfVolume:
    """`solid` on 8 cm-blocks of a lattice of 2 cm: where a block is farther than its radius and 1.2 cm it stores what is left."""
    grid = body_grid(solid, ORIGIN, VOXEL, (side, side, side))
    exact = grid.sdf.numpy()
    index = np.indices(exact.shape) // 4
    middle = np.minimum(4 * index + 2, side - 1)
    block = exact[tuple(middle)]
    bound = np.maximum(np.abs(block) - 0.052 - 0.012, VOXEL)
    known = np.abs(block) < 0.084
    stored = np.where(known, exact, np.sign(block) * bound).astype(np.float32)
    return SdfVolume(replace(grid, sdf=torch.from_numpy(stored), known=known))
