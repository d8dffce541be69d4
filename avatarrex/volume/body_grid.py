"""Step I for the body: its signed distance on a regular grid in the root frame (paper sec. 4, Step I).

The distance is guessed first: a voxel's height over the posed template, less what the avatar wears there (`clothing_offset`, the field's
own depth at the template's vertices at rest). Blocks of 4 and 2 voxels far from the surface are culled whole; voxels
whose guess is below `NARROW_BAND_VOXELS` voxels are evaluated, and then every voxel that a crossing touches (narrow_band.py). The rest keeps
a distance that never exceeds the true one. The field itself stays within `MAX_DEVIATION` of the guess (template_distance.py), and has no
hands (body_without_hands.py).

Letters: z y x voxels, p evaluated voxels, v template vertices. Root frame, metres, negative inside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from avatarrex.counters import Counters
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.composition import EMPTIED
from avatarrex.fields.template_distance import NearestSkin, TemplateDistance
from avatarrex.volume.bricks import RINGS, Bricks, grow_bricks
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import settle
from avatarrex.volume.sdf_volume import BodyGrid
from avatarrex.volume.temporal_reuse import PreviousGrid

MAX_SIDE = 128
"""Voxels along a side (paper sec. 4): the voxel grows rather than a limb being cut off."""
BOX_MARGIN = 0.09
"""Metres of box around the template: the thickest cloth, what the field may differ from it, and a voxel."""
NARROW_BAND_VOXELS = 1.0
"""Voxels: what is guessed nearer to the surface than this is evaluated at once."""
SLACK = 0.012
"""Metres by which a guess may be wrong; far values are this much smaller."""
BLOCK_VOXELS = 4
"""Voxels along a side of the largest blocks that are culled whole."""


def lattice_around(points: np.ndarray, voxel: float) -> Lattice:
    """The lattice at multiples of `voxel` metres that holds `points` (k, 3), at most `MAX_SIDE` voxels a side."""
    low, high = points.min(0), points.max(0)
    while True:
        first = np.floor(low / voxel).astype(int)
        size = np.ceil(high / voxel).astype(int) - first + 1
        if size.max() <= MAX_SIDE:
            return Lattice(first * voxel, voxel, (int(size[2]), int(size[1]), int(size[0])))
        voxel *= 1.001 * max(1.0, (high - low).max() / voxel / (MAX_SIDE - 2))


def build_body_grid(
    body: BodyWithoutHands,
    voxel: float,
    counters: Counters,
    everywhere: bool = False,
    kept: PreviousGrid | None = None,
) -> BodyGrid:
    """The body field around its surface, on multiples of `voxel` metres in the root frame.

    `everywhere`: at every voxel that a node reaches, as the paper has it. `kept`: what may be taken over.
    """
    skin = body.skin
    lattice = lattice_around(np.concatenate([skin.extent - BOX_MARGIN, skin.extent + BOX_MARGIN]), voxel)
    if kept is not None and kept.grid.voxel != lattice.voxel:  # it grew with the person's extent
        kept = None
    fill, first, nearest_skin, known = guess(skin, lattice, kept)
    if everywhere:
        reached = np.zeros(fill.size, dtype=bool)
        position = lattice.position(np.arange(fill.size))
        reached[body.field.pairs(body.frame, torch.as_tensor(position, dtype=torch.float32)).point] = True
        first = np.flatnonzero(reached)
        nearest_skin = skin.query(position[first])

    def evaluate(index: np.ndarray) -> np.ndarray:
        here = nearest_skin if index is first else skin.query(lattice.position(index))
        return evaluated(body, lattice.position(index), counters, here)

    sdf, known = settle(fill, first, evaluate, known)
    return BodyGrid(lattice.origin, lattice.voxel, torch.from_numpy(sdf), known=known)


def refined(
    body: BodyWithoutHands,
    grid: BodyGrid,
    seen: np.ndarray,
    bricks: Bricks,
    counters: Counters,
    rings: int = RINGS,
) -> BodyGrid:
    """`grid` with `bricks` of the same frame and those of the cells `seen` (flat), and how many `rings` of cells farther."""

    def evaluate(place: np.ndarray) -> np.ndarray:
        value = _stored(grid, place)
        rows = np.flatnonzero(np.isnan(value))
        value[rows] = evaluated(body, grid.origin + grid.voxel * place[rows], counters)
        return value

    return replace(grid, bricks=grow_bricks(grid.sdf.numpy(), grid.voxel, bricks, seen, evaluate, rings))


def _stored(grid: BodyGrid, place: np.ndarray) -> np.ndarray:
    """What the field was evaluated to at those `place`s (p, 3), in voxels, that are voxels; NaN at the others."""
    value = np.full(len(place), np.nan, dtype=np.float32)
    if grid.known is not None:
        rows = np.flatnonzero((place == np.rint(place)).all(1))
        voxel = tuple(place[rows, ::-1].astype(int).T)
        value[rows] = np.where(grid.known[voxel], grid.sdf.numpy()[voxel], np.nan)
    return value


def evaluated(
    body: BodyWithoutHands, position: np.ndarray, counters: Counters, here: NearestSkin | None = None
) -> np.ndarray:
    """The body's field at (p, 3) as it is stored: (p,) metres, single precision."""
    counters.add("voxels_evaluated", len(position))
    here = body.skin.query(position) if here is None else here
    with torch.no_grad():
        return body.sdf(torch.as_tensor(position, dtype=torch.float32), counters, here).numpy()


def guess(
    skin: TemplateDistance, lattice: Lattice, kept: PreviousGrid | None = None
) -> tuple[np.ndarray, np.ndarray, NearestSkin, np.ndarray]:
    """A distance (z, y, x) that never exceeds the true one; flat indices of voxels near the surface that are to be
    evaluated; the skin there; and which voxels (z, y, x) are known already, from `kept`.

    Coarse to fine: a block whose centre's guess exceeds its radius and `NARROW_BAND_VOXELS` holds no surface.
    """
    shape, reach = np.array(lattice.shape), NARROW_BAND_VOXELS * lattice.voxel
    near = np.ones(-(-shape // BLOCK_VOXELS), dtype=bool)
    fill = np.zeros(near.shape, dtype=np.float32)
    known = np.zeros(lattice.shape, dtype=bool)
    stored = None if kept is None else np.full(lattice.shape, np.nan, dtype=np.float32)
    side = BLOCK_VOXELS
    while True:
        block = np.stack(np.nonzero(near), -1)
        if side == 1 and kept is not None and stored is not None:
            stays = kept.onto(lattice, block, side, stored, known)
            near[near], block = ~stays, block[~stays]
        centre = lattice.origin + lattice.voxel * (block[:, ::-1] * side + (side - 1) / 2)
        radius = np.sqrt(3) * lattice.voxel * (side - 1) / 2
        here = skin.query(centre)
        least = np.maximum(np.abs(here.guess) - radius - SLACK, lattice.voxel)
        empty = here.weight == 1  # emptied: whatever the field holds there
        fill[near] = np.where(empty, np.maximum(least, EMPTIED), np.where(here.guess < 0, -least, least))
        slack = SLACK if side > 1 else 0.0
        close = (np.abs(here.guess) < reach + radius + slack) & ~(empty & (side == 1))
        if side == BLOCK_VOXELS and kept is not None and stored is not None:
            close[close] = ~kept.onto(lattice, block[close], side, stored, known)
        near[near] = close
        if side == 1:
            filled = fill if stored is None else np.where(np.isnan(stored), fill, stored)
            return filled, np.flatnonzero(near), here.at(close), known
        inner = tuple(slice(0, -(-int(n) // (side // 2))) for n in shape)
        near, fill = _halved(near)[inner], np.ascontiguousarray(_halved(fill)[inner])
        side //= 2


def _halved(blocks: np.ndarray) -> np.ndarray:
    """Each block as 2³ of half its side."""
    for axis in range(3):
        blocks = blocks.repeat(2, axis)
    return blocks
