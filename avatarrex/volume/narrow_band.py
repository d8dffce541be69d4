"""Evaluating a field only where its surface is: guess everywhere, evaluate where the guess is small, then make sure.

A ray caster sees a stored field through its cells: a cell whose corners have both signs holds surface. So a guess is good
enough where no such cell has a guessed corner; `settle` evaluates until that is so. The result has the same crossings as
evaluating everything, unless a surface hides wholly inside guessed voxels of one sign.

Letters: z y x voxels, p listed voxels. Metres, negative inside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Int

from avatarrex.ops.halving import touched
from avatarrex.volume.lattice import Lattice


def unsettled(inside: np.ndarray, known: np.ndarray, unused: np.ndarray | None = None) -> np.ndarray:
    """Flat indices of voxels that are not `known` (…, z, y, x) but corners of a cell in which `inside` (same) changes.

    `unused` voxels (same) are neither inside nor outside.
    """
    side = np.where(inside, np.int8(-1), np.int8(1))
    if unused is not None:
        side[unused] = 0
    corner = touched(side.reshape(-1, *side.shape[-3:])).reshape(side.shape)
    return np.flatnonzero(corner & ~known)


def crossed(inside: Bool[np.ndarray, "z y x"]) -> Int[np.ndarray, "c 3"]:
    """Cells (z, y, x) that have corners on both sides."""
    ends = (slice(None, -1), slice(1, None))
    corners = np.stack([inside[z, y, x] for z in ends for y in ends for x in ends])
    return np.argwhere(corners.any(0) & ~corners.all(0))


def settle(
    sdf: np.ndarray,
    first: np.ndarray,
    evaluate: Callable[[np.ndarray], np.ndarray],
    known: np.ndarray | None = None,
    unused: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Replace guesses in `sdf` (z, y, x) by `evaluate(flat indices)`: the `first` ones, then whatever a crossing touches.

    Voxels that are `known` (z, y, x) from the start stay as they are; those that are `unused` (same), too, and where they
    meet others is no crossing. Ends, because every round evaluates new voxels. Returns the distances and which voxels are
    known now.
    """
    sdf = np.array(sdf, order="C")
    known = np.zeros(sdf.shape, dtype=bool) if known is None else known.copy()
    if unused is not None:
        known |= unused
    wanted = first if len(first) else unsettled(sdf < 0, known, unused)
    while len(wanted):
        sdf.reshape(-1)[wanted] = evaluate(wanted)
        known.reshape(-1)[wanted] = True
        wanted = unsettled(sdf < 0, known, unused)
    return sdf, known


def halved(lattice: Lattice) -> Lattice:
    """The lattice of half the voxel whose every other voxel is one of `lattice`."""
    z, y, x = (2 * side - 1 for side in lattice.shape)
    return Lattice(lattice.origin, lattice.voxel / 2, (z, y, x))
