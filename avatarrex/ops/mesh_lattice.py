"""Distances and winding numbers of a mesh at the voxels of a lattice, in compiled loops on a CPU: exact, float64.

Triangle by triangle, not voxel by voxel. `winding_lattice`: a triangle's shadow along z covers a few columns of the lattice;
where its crossing with a column lies says which voxels of it lie below. The predicates are those of crossings.py, so the
numbers are those of `winding`. `paint_near`: every triangle offers its distance to the voxels in its reach, row by row in vector
registers; the distance to the nearest is then computed again as closest_triangle.py does. Its reference is that search.
`nearest_vertex` does the same with vertices; its reference is closest_vertex.py.

Letters: f faces, v vertices, z y x voxels. Metres.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int16, Shaped

from avatarrex.ops.closest_triangle import TINY, on_triangle
from avatarrex.ops.crossings import left_of
from avatarrex.ops.native import borrowing, native, spread
from avatarrex.ops.triangle import THIN

LANES = 8
"""Voxels of a row that are looked at together, needed or not: rows are short, and a register holds so many numbers."""
Array = Shaped[np.ndarray, "..."]
fused = partial(native, fused=True, borrows=True)


class Grid(NamedTuple):
    """Voxel (z, y, x) sits at origin + voxel · (x, y, z)."""

    origin: Array
    """(3,)"""
    voxel: float
    shape: tuple[int, int, int]

    def position(self, index: Int[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
        """Of voxels by their flat numbers."""
        z, y, x = np.unravel_index(index, self.shape)
        return np.asarray(self.origin + self.voxel * np.stack([x, y, z], -1))


class PaintedMesh(NamedTuple):
    """A closed mesh and a number that is painted on it."""

    corner: Array
    """(f, 3, 3)"""
    paint: Array
    """(f, 3) at the corners."""


class _Nearest(NamedTuple):
    """Of each voxel the nearest triangle, or vertex, so far."""

    square: Array
    """(z, y, x) squared distance; rows end with `LANES` voxels that are none."""
    face: Array
    """The same; −1: none in reach."""


class _Plan(NamedTuple):
    """What is the same of a triangle for all points, relative to its first corner."""

    b: Any
    """The second corner, and 1 over its squared distance."""
    c: Any
    """The third, and the same."""
    d: Any
    """From the second to the third, and the same."""
    v: Any
    """A point's second barycentric coordinate is its product with this, plus the last: −1 where there is no normal."""
    w: Any
    n: Any
    """Normal, and 1 over its squared length."""


def winding_lattice(corner: Float[np.ndarray, "f 3 3"], grid: Grid) -> Int16[np.ndarray, "z y x"]:
    """How many times the closed mesh wraps each voxel's centre."""
    found = np.zeros(grid.shape, np.int16)
    spread(_cross, grid.shape[1], corner, grid, found, few=1)
    return found


def paint_near(
    mesh: PaintedMesh,
    grid: Grid,
    inside: Bool[np.ndarray, "z y x"],
    within: float,
    values: Float[np.ndarray, "z y x 2"],
) -> int:
    """Where the mesh is nearer than `within`, `values` become the signed distance and the paint of its nearest point.

    How many voxels that are.
    """
    found = _nothing(grid, within)
    spread(_offer, grid.shape[0], mesh.corner, grid, within, found, few=1)
    spread(_write, grid.shape[0], mesh, grid, inside, found, values, few=1)
    return int(np.count_nonzero(found.face[:, :, : grid.shape[2]] >= 0))


def nearest_vertex(
    vertices: Float[np.ndarray, "v 3"], grid: Grid, within: float
) -> tuple[Float[np.ndarray, "z y x"], Int[np.ndarray, "z y x"]]:
    """Distances and numbers of the nearest vertices, of equals the first; ∞ and −1 where none is nearer than `within`."""
    found = _nothing(grid, within)
    spread(_offer_vertices, grid.shape[0], vertices, grid, within, found, few=1)
    square, number = (each[:, :, : grid.shape[2]] for each in found)
    return np.where(number < 0, np.inf, np.sqrt(square)), number.astype(np.int64)


def _nothing(grid: Grid, within: float) -> _Nearest:
    z, y, x = grid.shape
    shape = z, y, x + LANES
    return _Nearest(np.full(shape, within**2), np.full(shape, -1, np.int32))


@borrowing
def _span(low: float, high: float, grid: Grid, axis: int) -> tuple[int, int]:
    """First and last voxel from `low` to `high` along x, y, z (0, 1, 2)."""
    first, last = (low - grid.origin[axis]) / grid.voxel, (high - grid.origin[axis]) / grid.voxel
    return max(0, math.ceil(first)), min(grid.shape[2 - axis] - 1, math.floor(last))


@borrowing
def _extent(corner: Array, t: int, axis: int) -> tuple[float, float]:
    a, b, c = corner[t, 0, axis], corner[t, 1, axis], corner[t, 2, axis]
    return min(a, b, c), max(a, b, c)


@native
def _cross(begin: int, end: int, corner: Array, grid: Grid, found: Array) -> None:
    """`found` of the rows y from `begin` to `end`: first what each crossing adds to all voxels below it, then their sums."""
    for t in range(len(corner)):
        low_x, high_x = _extent(corner, t, 0)
        low_y, high_y = _extent(corner, t, 1)
        first_x, last_x = _span(low_x - grid.voxel, high_x + grid.voxel, grid, 0)  # a voxel to spare for rounding
        first_y, last_y = _span(low_y - grid.voxel, high_y + grid.voxel, grid, 1)
        for j in range(max(first_y, begin), min(last_y, end - 1) + 1):
            for i in range(first_x, last_x + 1):
                _cross_column(corner, t, grid, (j, i), found)
    for k in range(len(found) - 2, -1, -1):
        for j in range(begin, end):
            for i in range(found.shape[2]):
                found[k, j, i] += found[k + 1, j, i]


@borrowing
def _cross_column(corner: Array, t: int, grid: Grid, column: tuple[int, int], found: Array) -> None:
    """Add what triangle t is to the highest voxel below it in a column: the steps of crossings.py."""
    j, i = column
    x, y = grid.origin[0] + grid.voxel * i, grid.origin[1] + grid.voxel * j
    left = left_of(x, y, corner, t, 0, 1)
    if left_of(x, y, corner, t, 1, 2) != left or left_of(x, y, corner, t, 2, 0) != left:
        return
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    abx, aby, abz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    acx, acy, acz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    side = 1.0 if left else -1.0
    _, high_z = _extent(corner, t, 2)
    k = min(math.floor((high_z - grid.origin[2]) / grid.voxel), len(found) - 1)
    while k >= 0 and (nx * (x - ax) + ny * (y - ay) + nz * (grid.origin[2] + grid.voxel * k - az)) * side >= 0:
        k -= 1
    if k >= 0:
        found[k, j, i] += 1 if left else -1


@borrowing
def _plan(corner: Array, t: int) -> Any:
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    bx, by, bz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    cx, cy, cz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
    dx, dy, dz = cx - bx, cy - by, cz - bz
    bb, cc, dd = bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz, dx * dx + dy * dy + dz * dz
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    area2 = nx * nx + ny * ny + nz * nz
    thick = area2 > (THIN * max(bb, cc, dd)) ** 2
    per_area, flat = (1 / area2, 0.0) if thick else (0.0, -1.0)
    v = (cy * nz - cz * ny) * per_area, (cz * nx - cx * nz) * per_area, (cx * ny - cy * nx) * per_area, flat
    w = (ny * bz - nz * by) * per_area, (nz * bx - nx * bz) * per_area, (nx * by - ny * bx) * per_area
    b, c, d = (bx, by, bz, 1 / max(bb, TINY)), (cx, cy, cz, 1 / max(cc, TINY)), (dx, dy, dz, 1 / max(dd, TINY))
    return _Plan(b, c, d, v, w, (nx, ny, nz, per_area))


@native
def _offer(begin: int, end: int, corner: Array, grid: Grid, within: float, found: _Nearest) -> None:
    """`found` of the layers z from `begin` to `end`; of equals the first."""
    for t in range(len(corner)):
        low_z, high_z = _extent(corner, t, 2)
        first_z, last_z = _span(low_z - within, high_z + within, grid, 2)
        if first_z >= end or last_z < begin:
            continue
        plan = _plan(corner, t)
        low_x, high_x = _extent(corner, t, 0)
        low_y, high_y = _extent(corner, t, 1)
        first_x, last_x = _span(low_x - within, high_x + within, grid, 0)
        first_y, last_y = _span(low_y - within, high_y + within, grid, 1)
        for k in range(max(first_z, begin), min(last_z, end - 1) + 1):
            z = grid.origin[2] + grid.voxel * k
            gap_z = max(low_z - z, z - high_z, 0.0)
            for j in range(first_y, last_y + 1):
                y = grid.origin[1] + grid.voxel * j
                gap_y = max(low_y - y, y - high_y, 0.0)
                if gap_z * gap_z + gap_y * gap_y < within * within:
                    start = grid.origin[0] - corner[t, 0, 0], y - corner[t, 0, 1], z - corner[t, 0, 2], grid.voxel
                    _offer_row(plan, start, (k, j, first_x, last_x), t, found)


@fused
def _offer_row(plan: Any, start: Any, row: tuple[int, int, int, int], t: int, found: _Nearest) -> None:
    """The squared distance of triangle t to a row of voxels: the least of three segments and, over it, the height."""
    x0, y, z, voxel = start
    (bx, by, bz, per_b), (cx, cy, cz, per_c), (dx, dy, dz, per_d) = plan.b, plan.c, plan.d
    (vx, vy, vz, v0), (wx, wy, wz), (nx, ny, nz, per_area) = plan.v, plan.w, plan.n
    bb, cc, dd = bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz, dx * dx + dy * dy + dz * dz
    v0, w0, height0 = v0 + y * vy + z * vz, y * wy + z * wz, y * ny + z * nz
    b0, c0, d0 = y * by + z * bz, y * cy + z * cz, (y - by) * dy + (z - bz) * dz
    a_square, b_square = y * y + z * z, (y - by) ** 2 + (z - bz) ** 2
    square, face = found
    k, j = np.uint64(row[0]), np.uint64(row[1])  # signed ones might count from the end: no registers
    for first in range(row[2], row[3] + 1, LANES):
        for lane in range(LANES):
            i = np.uint64(first) + np.uint64(lane)
            x = x0 + voxel * (first + lane)
            v, w, height = v0 + x * vx, w0 + x * wx, height0 + x * nx
            on_b, on_c, on_d = b0 + x * bx, c0 + x * cx, d0 + (x - bx) * dx
            tb, tc, td = (
                min(max(on_b * per_b, 0.0), 1.0),
                min(max(on_c * per_c, 0.0), 1.0),
                min(max(on_d * per_d, 0.0), 1.0),
            )
            to_a, to_b = a_square + x * x, b_square + (x - bx) * (x - bx)
            edge = min(to_a + tb * (tb * bb - 2 * on_b), to_a + tc * (tc * cc - 2 * on_c))
            edge = min(edge, to_b + td * (td * dd - 2 * on_d))
            over, best, before = height * height * per_area, square[k, j, i], face[k, j, i]
            here = over if min(v, w, 1 - v - w) >= 0 else edge
            square[k, j, i] = here if here < best else best
            face[k, j, i] = t if here < best else before


@native
def _offer_vertices(begin: int, end: int, vertices: Array, grid: Grid, within: float, found: _Nearest) -> None:
    """`found` of the layers z from `begin` to `end`; distances are rounded as those of closest_vertex.py."""
    square, number = found
    for v in range(len(vertices)):
        vx, vy, vz = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        first_z, last_z = _span(vz - within, vz + within, grid, 2)
        first_y, last_y = _span(vy - within, vy + within, grid, 1)
        first_x, last_x = _span(vx - within, vx + within, grid, 0)
        for z in range(max(first_z, begin), min(last_z, end - 1) + 1):
            z2 = (vz - (grid.origin[2] + grid.voxel * z)) ** 2
            for y in range(first_y, last_y + 1):
                y2 = (vy - (grid.origin[1] + grid.voxel * y)) ** 2
                if y2 + z2 < within * within:
                    k, j = np.uint64(z), np.uint64(y)  # see `_offer_row`
                    for first in range(first_x, last_x + 1, LANES):
                        for lane in range(LANES):
                            i = np.uint64(first) + np.uint64(lane)
                            here = (vx - (grid.origin[0] + grid.voxel * (first + lane))) ** 2 + y2 + z2
                            nearer = here < square[k, j, i]
                            square[k, j, i] = here if nearer else square[k, j, i]
                            number[k, j, i] = v if nearer else number[k, j, i]


@native
def _write(begin: int, end: int, mesh: PaintedMesh, grid: Grid, inside: Array, found: _Nearest, values: Array) -> None:
    """`values` of the layers z from `begin` to `end`."""
    for k in range(begin, end):
        for j in range(grid.shape[1]):
            for i in range(grid.shape[2]):
                t = found.face[k, j, i]
                if t >= 0:
                    x, y = grid.origin[0] + grid.voxel * i, grid.origin[1] + grid.voxel * j
                    square, u, v, w = on_triangle(mesh.corner, t, (x, y, grid.origin[2] + grid.voxel * k))
                    values[k, j, i, 0] = -math.sqrt(square) if inside[k, j, i] else math.sqrt(square)
                    values[k, j, i, 1] = u * mesh.paint[t, 0] + v * mesh.paint[t, 1] + w * mesh.paint[t, 2]
