"""Sparse bricks: cells of the body grid cut into smaller ones where the surface is seen (architecture: levels).

The body's surface is stored at 2 cm, which blurs hems and folds. A brick replaces one cell of the grid by side³ smaller
cells, evaluated only around the surface; all bricks lie in one atlas texture, found by a number per cell. Bricks share
nothing: each holds its own (side + 1)³ corners, so that interpolation never leaves one.

Letters: m bricks, z y x coarse cells, p points. Root frame, metres, negative inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int, Shaped
from torch import Tensor

from avatarrex.ops.trilinear import trilinear
from avatarrex.volume.narrow_band import unsettled

ROW = 24
"""Bricks along x and y of the atlas."""
NARROW_BAND_FINE_VOXELS = 0.6
"""Fine voxels: what is guessed nearer to the surface than this is evaluated at once."""
RINGS = 2
"""How many cells the bricks follow the surface past what a view saw: rays meet every cell but some that it grazes."""


@dataclass(frozen=True, eq=False)
class Bricks:
    """Refined cells of one body grid."""

    side: int
    """Fine voxels along a coarse one."""
    cell: Int[np.ndarray, " m"]
    """Flat index of each brick's coarse cell."""
    value: Float32[np.ndarray, "m n n n"]
    """The field at each brick's corners, z y x, n = side + 1."""
    known: Bool[np.ndarray, "m n n n"]
    """Corners that the field was evaluated at; `value` is interpolated at the others."""
    number: Float32[Tensor, "z y x"]
    """Brick of a cell, counted from 1; 0 where there is none."""
    atlas: Float32[Tensor, "az ay ax"]
    """What is stored: the layers of the grid itself and, behind them, all bricks side by side, `ROW` along x, then y, then z: a ray
    reads either by one look-up."""

    @staticmethod
    def of(side: int, cell: np.ndarray, value: np.ndarray, known: np.ndarray, sdf: np.ndarray) -> Bricks:
        """Bricks of the flat cells (m,) of a grid `sdf` (z, y, x), with values at their corners (m, n, n, n) and which are `known`."""
        number = np.zeros([size - 1 for size in sdf.shape], dtype=np.float32)
        number.reshape(-1)[cell] = np.arange(1, len(cell) + 1)
        return Bricks(side, cell, value, known, torch.from_numpy(number), _atlas(value, sdf))

    @staticmethod
    def none(side: int, sdf: np.ndarray) -> Bricks:
        """No bricks yet of side³ voxels in a grid `sdf` (z, y, x)."""
        corners = 0, *(side + 1,) * 3
        return Bricks.of(side, np.zeros(0, np.int64), np.zeros(corners, np.float32), np.zeros(corners, bool), sdf)

    def storing(self, value: Float32[np.ndarray, "m n n n"], sdf: Float32[np.ndarray, "z y x"]) -> Bricks:
        """The same bricks, of which the atlas stores these values in a grid that stores `sdf`."""
        return replace(self, atlas=_atlas(value, sdf))

    def extended(self, corner: Shaped[np.ndarray, "m n n n"], axis: int) -> Shaped[np.ndarray, "m _ _ _"]:
        """With a corner more at both ends of `axis` (0 to 2), from the bricks beside; zero where there is none."""
        number = np.pad(self.number.numpy().astype(int), 1)
        place = np.stack(np.unravel_index(self.cell, tuple(self.number.shape))) + 1
        step = np.eye(3, dtype=int)[axis, :, None]
        ends = []
        for aside, second in ((place - step, -2), (place + step, 1)):
            beside = number[tuple(aside)]
            layer = np.take(corner, [second], axis + 1)
            ends.append(np.where((beside > 0)[:, None, None, None], layer[beside - 1], 0).astype(corner.dtype))
        return np.concatenate([ends[0], corner, ends[1]], axis + 1)

    def sample(self, place: Float[Tensor, "p 3"]) -> tuple[Int[Tensor, " r"], Float[Tensor, " r"]]:
        """Which points, in coarse voxel coordinates inside the grid, lie in bricks (r,), and their values (r,)."""
        last = torch.tensor(self.number.shape).flip(0) - 1
        cell = place.floor().long().clamp(min=0).minimum(last)
        brick = self.number[cell[:, 2], cell[:, 1], cell[:, 0]].long() - 1
        rows = torch.nonzero(brick >= 0)[:, 0]
        tile = torch.stack([brick[rows] % ROW, brick[rows] // ROW % ROW, brick[rows] // ROW**2], 1)
        local = (place[rows] - cell[rows]).clamp(0, 1) * self.side + tile * (self.side + 1)
        local[:, 2] += self.number.shape[0] + 1
        return rows, trilinear(self.atlas[..., None], local)[:, 0]


def _atlas(value: np.ndarray, sdf: np.ndarray) -> Tensor:
    """`sdf` (z, y, x) and behind it corner values (m, n, n, n) side by side."""
    count, n = value.shape[:2]
    whole = np.zeros((max(-(-count // ROW**2), 1) * ROW**2, n, n, n), dtype=np.float32)
    whole[:count] = value
    tiled = whole.reshape(-1, ROW, ROW, n, n, n).transpose(0, 3, 1, 4, 2, 5).reshape(-1, ROW * n, ROW * n)
    joined = np.zeros((len(sdf) + len(tiled), *np.maximum(sdf.shape[1:], ROW * n)), dtype=np.float32)
    for layer, part in ((0, sdf), (len(sdf), tiled)):
        joined[layer : layer + len(part), : part.shape[1], : part.shape[2]] = part
    return torch.from_numpy(joined)


def grow_bricks(
    sdf: np.ndarray,
    voxel: float,
    bricks: Bricks,
    seen: np.ndarray,
    evaluate: Callable[[np.ndarray], np.ndarray],
    rings: int = RINGS,
) -> Bricks:
    """`bricks` with those of the cells `seen` (flat) and of the `rings` of cells that their surface runs on into.

    `sdf` (z, y, x) is the coarse grid of `voxel` metres; `evaluate` gives the field (p,) at fractional coarse voxels (p, 3) x y z. Values
    that are not evaluated are interpolated: no cell with a crossing has any. Returns `bricks` itself when nothing is new.
    """
    shape, side = tuple(n - 1 for n in sdf.shape), bricks.side
    cells, values, known = bricks.cell, bricks.value, bricks.known
    wanted = np.setdiff1d(seen, cells)
    if not len(wanted):
        return bricks
    for _ in range(rings + 1):
        cells = np.concatenate([cells, wanted])
        new = _refine(sdf, NARROW_BAND_FINE_VOXELS * voxel / side, side, wanted, evaluate)
        values, known = (np.concatenate(pair) for pair in zip((values, known), new))
        wanted = np.setdiff1d(_beyond(cells, values < 0, shape), cells)
        if not len(wanted):
            break
    return Bricks.of(side, cells, values, known, sdf)


def _refine(
    sdf: np.ndarray, reach: float, side: int, cells: np.ndarray, evaluate: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Corner values (m, n, n, n) of new bricks, interpolated or, within `reach` and at every crossing, evaluated; and which are."""
    n, shape = side + 1, tuple(k - 1 for k in sdf.shape)
    corner = np.stack(np.unravel_index(cells, shape), -1)
    step = np.stack(np.meshgrid(*(np.arange(n),) * 3, indexing="ij"), -1)
    fine = corner[:, None, None, None] * side + step
    extent = [k * side + 1 for k in shape]
    point, place = np.unique(np.ravel_multi_index(tuple(np.moveaxis(fine, -1, 0)), extent), return_inverse=True)
    place = place.reshape(fine.shape[:-1])
    position = np.stack(np.unravel_index(point, extent)[::-1], -1) / side
    coarse = trilinear(torch.from_numpy(sdf)[..., None], torch.from_numpy(position))
    value = coarse[:, 0].numpy().astype(np.float32)
    known = np.zeros(len(value), dtype=bool)
    wanted = np.flatnonzero(np.abs(value) < reach)
    while len(wanted):
        value[wanted] = evaluate(position[wanted])
        known[wanted] = True
        wanted = np.unique(place.reshape(-1)[unsettled(value[place] < 0, known[place])])
    return value[place], known[place]


def _beyond(cells: np.ndarray, inside: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Flat cells on the other side of those faces of bricks (m, n, n, n) that a crossing meets."""
    place = np.stack(np.unravel_index(cells, shape), -1)
    found = []
    for axis in range(3):
        for end, step in ((0, -1), (-1, 1)):
            face = np.take(inside, end, axis + 1)
            next_to = place[face.any((1, 2)) & ~face.all((1, 2))]
            next_to[:, axis] += step
            within = (next_to[:, axis] >= 0) & (next_to[:, axis] < shape[axis])
            found.append(np.ravel_multi_index(tuple(next_to[within].T), shape))
    return np.unique(np.concatenate(found))
