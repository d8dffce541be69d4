"""Evaluating a field only where its surface is: guess everywhere, evaluate where the guess is small, then make sure.

A ray caster sees a stored field through its cells: a cell whose corners have both signs holds surface. So a guess is good
enough where no such cell has a guessed corner; `settle` evaluates until that is so. The result has the same crossings as
evaluating everything, unless a surface hides wholly inside guessed voxels of one sign.

Letters: z y x voxels, p listed voxels. Metres, negative inside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from avatarrex.volume.lattice import Lattice

BOTH = (slice(None, -1), slice(1, None))


def unsettled(inside: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Flat indices of voxels that are not `known` (…, z, y, x) but corners of a cell in which `inside` (same) changes."""
    some, every = inside, inside
    for axis in (-3, -2, -1):
        some, every = (np.moveaxis(mask, axis, 0) for mask in (some, every))
        some, every = some[BOTH[0]] | some[BOTH[1]], every[BOTH[0]] & every[BOTH[1]]
        some, every = (np.moveaxis(mask, 0, axis) for mask in (some, every))
    crossed = some & ~every
    corner = np.zeros(inside.shape, dtype=bool)
    for z in BOTH:
        for y in BOTH:
            for x in BOTH:
                corner[..., z, y, x] |= crossed
    return np.flatnonzero(corner & ~known)


def settle(
    sdf: np.ndarray,
    first: np.ndarray,
    evaluate: Callable[[np.ndarray], np.ndarray],
    known: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Replace guesses in `sdf` (z, y, x) by `evaluate(flat indices)`: the `first` ones, then whatever a crossing touches.

    Voxels that are `known` (z, y, x) from the start stay as they are. Ends, because every round evaluates new voxels.
    Returns the distances and which voxels are known now.
    """
    sdf = np.ascontiguousarray(sdf).copy()
    known = np.zeros(sdf.shape, dtype=bool) if known is None else known.copy()
    wanted = first if len(first) else unsettled(sdf < 0, known)
    while len(wanted):
        sdf.reshape(-1)[wanted] = evaluate(wanted)
        known.reshape(-1)[wanted] = True
        wanted = unsettled(sdf < 0, known)
    return sdf, known


def halved(lattice: Lattice) -> Lattice:
    """The lattice of half the voxel whose every other voxel is one of `lattice`."""
    z, y, x = (2 * side - 1 for side in lattice.shape)
    return Lattice(lattice.origin, lattice.voxel / 2, (z, y, x))


def between(values: np.ndarray) -> np.ndarray:
    """(z, y, x, …) on a lattice -> the same on its `halved` lattice, new voxels by the mean of their neighbours."""
    for axis in range(3):
        values = np.moveaxis(values, axis, 0)
        fine = np.empty((2 * len(values) - 1, *values.shape[1:]), dtype=values.dtype)
        fine[::2] = values
        fine[1::2] = (values[:-1] + values[1:]) / 2
        values = np.moveaxis(fine, 0, axis)
    return values
