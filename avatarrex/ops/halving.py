"""A lattice halved, and the corners of its cells in which the side changes, in compiled loops on a CPU (ops/native.py).

Both go over whole lattices, once for each round of a narrow band: numpy's passes over the same bytes take five times as long.

Letters: b lattices, z y x voxels, c channels.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int8, Shaped

from avatarrex.ops.native import native, spread

Array = Shaped[np.ndarray, "..."]
BOTH = (slice(None, -1), slice(1, None))
SMALL = 1 << 16
"""Voxels up to which one thread is done before others have started."""


def between(values: Float[np.ndarray, "z y x *c"]) -> Float[np.ndarray, "_ _ _ *c"]:
    """(z, y, x, …) on a lattice -> the same on the one of half the voxel, new voxels by the mean of their neighbours."""
    z, y, x = (2 * side - 1 for side in values.shape[:3])
    coarse = np.ascontiguousarray(values).reshape(*values.shape[:3], -1)
    fine = np.empty((z, y, x, coarse.shape[3]), values.dtype)
    spread(_between, z, coarse, fine, few=1 if fine.size > SMALL else z)
    return fine.reshape(z, y, x, *values.shape[3:])


def between_reference(values: Float[np.ndarray, "z y x *c"]) -> Float[np.ndarray, "_ _ _ *c"]:
    """Axis by axis."""
    for axis in range(3):
        values = np.moveaxis(values, axis, 0)
        fine = np.empty((2 * len(values) - 1, *values.shape[1:]), dtype=values.dtype)
        fine[::2] = values
        fine[1::2] = (values[:-1] + values[1:]) / 2
        values = np.moveaxis(fine, 0, axis)
    return values


def touched(side: Int8[np.ndarray, "b z y x"]) -> Bool[np.ndarray, "b z y x"]:
    """Corners of the cells that have corners of side −1 and of side 1; those of side 0 count as neither."""
    side = np.ascontiguousarray(side)
    lattices, z, y, x = side.shape
    found, crossed = np.empty(side.shape, np.bool_), np.zeros((lattices, z + 1, y + 1, x + 1), np.bool_)
    few = 1 if side.size > SMALL else side.size
    spread(_crossed, lattices * (z - 1), side, crossed, few=few)
    spread(_touched, lattices * z, crossed, found, few=few)
    return found


def touched_reference(side: Int8[np.ndarray, "b z y x"]) -> Bool[np.ndarray, "b z y x"]:
    """Cell by cell of whole arrays."""
    low, high = side, side
    for axis in (-3, -2, -1):
        low, high = (np.moveaxis(mask, axis, 0) for mask in (low, high))
        low, high = np.minimum(low[BOTH[0]], low[BOTH[1]]), np.maximum(high[BOTH[0]], high[BOTH[1]])
        low, high = (np.moveaxis(mask, 0, axis) for mask in (low, high))
    found = np.zeros(side.shape, dtype=bool)
    for z in BOTH:
        for y in BOTH:
            for x in BOTH:
                found[..., z, y, x] |= (low < 0) & (high > 0)
    return found


@native
def _between(begin: int, end: int, coarse: Array, fine: Array) -> None:
    """`fine` of the layers z from `begin` to `end`; means in the order z, y, x, as the reference rounds them."""
    _, columns, rows, channels = coarse.shape
    half = coarse.dtype.type(0.5)
    for k in range(begin, end):
        z0, z1 = k // 2, (k + 1) // 2
        for j in range(2 * columns - 1):
            y0, y1 = j // 2, (j + 1) // 2
            for i in range(rows):
                for c in range(channels):
                    before = (coarse[z0, y0, i, c] + coarse[z1, y0, i, c]) * half
                    fine[k, j, 2 * i, c] = (before + (coarse[z0, y1, i, c] + coarse[z1, y1, i, c]) * half) * half
            for i in range(rows - 1):
                for c in range(channels):
                    fine[k, j, 2 * i + 1, c] = (fine[k, j, 2 * i, c] + fine[k, j, 2 * i + 2, c]) * half


@native
def _crossed(begin: int, end: int, side: Array, crossed: Array) -> None:
    """Whether cell (b, z, y, x) has corners of both sides, at (b, z + 1, y + 1, x + 1) of `crossed`; layers (b, z) as rows."""
    _, layers, columns, rows = side.shape
    for layer in range(begin, end):
        b, k = layer // (layers - 1), layer % (layers - 1)
        for j in range(columns - 1):
            for i in range(rows - 1):
                low, high = np.int8(0), np.int8(0)
                for z in range(2):
                    for y in range(2):
                        for x in range(2):
                            low = min(low, side[b, k + z, j + y, i + x])
                            high = max(high, side[b, k + z, j + y, i + x])
                crossed[b, k + 1, j + 1, i + 1] = (low < 0) & (high > 0)


@native
def _touched(begin: int, end: int, crossed: Array, found: Array) -> None:
    """Whether one of the eight cells around voxel (b, z, y, x) is `crossed`; layers (b, z) as rows."""
    _, layers, columns, rows = found.shape
    for layer in range(begin, end):
        b, k = layer // layers, layer % layers
        for j in range(columns):
            for i in range(rows):
                some = False
                for z in range(2):
                    for y in range(2):
                        for x in range(2):
                            some |= crossed[b, k + z, j + y, i + x]
                found[b, k, j, i] = some
