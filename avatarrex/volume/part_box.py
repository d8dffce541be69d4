"""Step I for hands and face: fine boxes of (signed distance, ω) that live in wrist and head frames.

A box depends on the part's own coefficients alone, so a moving body only moves it (paper sec. 4, 'refine the hands and
the face'; docs/architecture.md). It is evaluated coarse to fine: voxels half as large get the mean of their neighbours,
and the field only where that is within `BAND_VOXELS` of the surface or a crossing touches them (narrow_band.py). A part
that knows where its surface is samples its whole box by itself.

Letters: z y x voxels, v vertices. Part frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float16
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.ops.halving import between
from avatarrex.ops.mesh_lattice import Grid
from avatarrex.parts.part import Part, PartState
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import halved, settle

BAND_VOXELS = 1.0
"""Coarse voxels from the interpolated surface within which finer voxels are evaluated."""


@dataclass(frozen=True)
class UnplacedBox:
    """A part's box before it is placed in the root frame."""

    name: str
    origin: np.ndarray
    """Voxel 0's centre in the part frame, (3,) metres."""
    voxel: float
    field: Float16[Tensor, "z y x 2"]
    """Signed distance clamped to ±5.1 cm, and ω; half precision errs by 2e-6 m within 4 mm, by 2e-5 m at the clamp."""

    @property
    def lattice(self) -> Lattice:
        """Where its voxels are, part frame."""
        z, y, x = self.field.shape[:3]
        return Lattice(self.origin, self.voxel, (z, y, x))


def coarse_lattice(part: Part[Any], vertices: Tensor, voxel: float) -> Lattice:
    """The lattice that the box of a posed mesh (v, 3) begins with; `voxel` metres is the side of the final voxels."""
    coarse = 2**part.halvings * voxel
    low, high = part.bounds(vertices)
    first = np.floor(low / coarse).astype(int)
    size = np.ceil(high / coarse).astype(int) - first + 1
    return Lattice(first * coarse, coarse, (int(size[2]), int(size[1]), int(size[0])))


def build_part_box(
    part: Part[Any], state: PartState, vertices: Tensor, voxel: float, counters: Counters, everywhere: bool = False
) -> UnplacedBox:
    """The part's field around its surface; `everywhere`: at every voxel where it is used."""
    lattices = [coarse_lattice(part, vertices, voxel)]
    for _ in range(part.halvings):
        lattices.append(halved(lattices[-1]))
    sampled = None if everywhere else part.sample(state, [_grid(lattice) for lattice in lattices], counters)
    values = _narrow_band(part, state, lattices, counters, everywhere) if sampled is None else sampled
    return UnplacedBox(part.name, lattices[-1].origin, lattices[-1].voxel, torch.from_numpy(values).half())


def _grid(lattice: Lattice) -> Grid:
    return Grid(lattice.origin, lattice.voxel, lattice.shape)


def _narrow_band(
    part: Part[Any], state: PartState, lattices: list[Lattice], counters: Counters, everywhere: bool
) -> np.ndarray:
    """Values (z, y, x, 2) at the last of `lattices`, each half of the one before."""

    def evaluate(lattice: Lattice, index: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            values = part.evaluate(state, torch.as_tensor(lattice.position(index), dtype=torch.float32))
        counters.add(part.work, len(index))
        return values.numpy()

    first = lattices[0]
    start = part.start(state, _grid(first), everywhere)
    found = evaluate(first, start.first)
    values = start.values
    values[start.first, : found.shape[1]] = found
    values = values.reshape(*first.shape, 2)
    unused = None if start.unused is None else start.unused.reshape(first.shape)
    for lattice in lattices[1:]:
        values, unused = _refine(lattice, values, evaluate, unused, everywhere)
    return values


def _refine(
    lattice: Lattice,
    values: np.ndarray,
    evaluate: Callable[[Lattice, np.ndarray], np.ndarray],
    unused: np.ndarray | None,
    everywhere: bool,
) -> tuple[np.ndarray, np.ndarray | None]:
    """`values` (z, y, x, 2) and `unused` voxels (z, y, x) of twice the voxel at `lattice`; `evaluate` gives (p, 1 or 2) channels."""
    values = between(values)
    closed = None if unused is None else between(unused.astype(np.float32)) == 1
    near = (np.abs(values[..., 0]) < BAND_VOXELS * 2 * lattice.voxel) | everywhere
    flat = values.reshape(-1, 2)

    def at(index: np.ndarray) -> np.ndarray:
        found = evaluate(lattice, index)
        flat[index, : found.shape[1]] = found
        return found[:, 0]

    first = np.flatnonzero(near if closed is None else near & ~closed)
    values[..., 0], _ = settle(values[..., 0], first, at, unused=closed)
    return values, closed
