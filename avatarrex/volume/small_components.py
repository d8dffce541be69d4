"""Small components: pieces of body that float in the air, a few voxels large.

Between limbs that nearly touch, where no picture has looked, a learnt field is not sure of its sign. What the stored voxels make of
that as a body of its own is taken out; the paper keeps it (sec. 4), and so does the level `paper`.

Letters: z y x voxels. Metres, negative inside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy import ndimage

from avatarrex.volume.sdf_volume import BodyGrid

SMALL_VOXELS = 8
"""Voxels: a larger component may be clothing."""
FINER = 4
"""Samples per voxel side with which interpolation is checked for a bridge to a neighbouring component."""
ROUND = 2
"""Voxels around a component in which that is checked."""


def without_small_components(grid: BodyGrid) -> BodyGrid:
    """The grid with its small components emptied; their voxels count as not evaluated."""
    sdf = grid.sdf.numpy()
    inside, count = ndimage.label(sdf < 0)
    found = []
    if count > 1:
        size = np.bincount(inside.ravel())
        small = np.flatnonzero(size[1:] <= SMALL_VOXELS) + 1
        boxes = ndimage.find_objects(inside)
        found = [label for label in small if _floats(sdf, inside, int(label), boxes[label - 1])]
    if not found:
        return grid
    floating = np.isin(inside, found)
    air = ndimage.minimum_filter(np.where(sdf >= 0, sdf, np.inf), size=3, mode="nearest")
    emptied = np.where(floating, np.minimum(air, 0.5 * grid.voxel), sdf).astype(np.float32)
    known = None if grid.known is None else grid.known & ~floating
    return replace(grid, sdf=torch.from_numpy(emptied), known=known)


def _floats(sdf: np.ndarray, inside: np.ndarray, label: int, box: tuple[slice, ...]) -> bool:
    """Whether the surface about a small component is closed, as interpolation has it."""
    about = tuple(slice(max(side.start - ROUND, 0), min(side.stop + ROUND, end)) for side, end in zip(box, sdf.shape))
    fine = sdf[about]
    for axis in range(3):
        fine = _finer(fine, axis)
    joined, _ = ndimage.label(fine < 0)
    there = inside[about]
    at_voxels = joined[::FINER, ::FINER, ::FINER]
    own = at_voxels[there == label]
    return not np.isin(at_voxels[(there > 0) & (there != label)], own).any()


def _finer(values: np.ndarray, axis: int) -> np.ndarray:
    """Linear interpolation at `FINER` places a voxel along an axis."""
    values = np.moveaxis(values, axis, 0)
    place = np.arange(FINER * (len(values) - 1) + 1) / FINER
    low = np.minimum(place.astype(int), len(values) - 2)
    part = (place - low)[:, None, None]
    return np.moveaxis((1 - part) * values[low] + part * values[low + 1], 0, axis)
