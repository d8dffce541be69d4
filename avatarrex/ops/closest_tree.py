"""The closest triangle of a mesh by a tree of boxes, in compiled loops on a CPU (ops/native.py): exact, float64.

Triangles are sorted along a Morton curve through their centres, and a box holds a run of them, halved down to `LEAF`; halves
at medians are searched a sixth faster and take four times as long to sort. Each point starts from the triangle that was closest
to the point before: points of a lattice or of a picture lie in order, and few boxes are nearer. Which of
the triangles of an edge is found depends on it, too.

Letters: p points, v vertices, f faces, b boxes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from avatarrex.ops.closest_bricks import morton
from avatarrex.ops.native import native, spread
from avatarrex.ops.triangle import THIN

LEAF = 4
"""Triangles of a box that is not split."""
GRID = 2**20 - 1
"""Cells along an axis of the curve."""
DEEP = 64
"""Boxes that may wait at once: the tree's depth, with room to spare."""
TINY = float(np.finfo(np.float64).tiny)
Array = Shaped[np.ndarray, "..."]


@dataclass(frozen=True)
class TriangleTree:
    """A mesh, prepared."""

    corner: Array
    """(f, 3, 3) float64, in the order of the boxes."""
    face: Array
    """(f,) which is which."""
    box: Array
    """(b, 2, 3) lowest and highest corner; a box's first half follows it."""
    other: Array
    """(b,) its other half; of a box that is not split its first triangle."""
    count: Array
    """(b,) triangles of a box that is not split, else 0."""

    @classmethod
    def of(cls, vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> TriangleTree:
        """Of at least one triangle, metres."""
        unsorted = vertices.detach().double()[faces]
        centre = unsorted.mean(1)
        low, extent = centre.amin(0), float((centre.amax(0) - centre.amin(0)).max()) or 1.0
        order = morton(((centre - low) / extent * GRID).long()).argsort(stable=True)
        corner, room = unsorted[order].contiguous().numpy(), max(1, 4 * len(order) // LEAF)
        box, other, count = np.empty((room, 2, 3)), np.zeros(room, np.int64), np.zeros(room, np.int64)
        used = _build(corner, box, other, count)
        return cls(corner, order.numpy(), box[:used], other[:used], count[:used])

    @torch.no_grad()
    def closest(self, points: Float[Tensor, "p 3"]) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 3"]]:
        """Closest face and the barycentrics of its closest point (float64, exact zeros off the feature that holds it)."""
        query = points.double().contiguous().numpy()
        face, weight = np.empty(len(query), np.int64), np.empty((len(query), 3))
        spread(_search, len(query), query, self.corner, self.box, self.other, self.count, face, weight)
        return torch.from_numpy(self.face[face]), torch.from_numpy(weight)


@native
def _build(corner: Array, box: Array, other: Array, count: Array) -> int:
    """Fill the boxes of the sorted triangles; how many there are."""
    begin, end, above = np.empty(DEEP, np.int64), np.empty(DEEP, np.int64), np.empty(DEEP, np.int64)
    begin[0], end[0], above[0] = 0, len(corner), -1
    waiting, used = 1, 0
    while waiting:
        waiting -= 1
        first, last, here = begin[waiting], end[waiting], used
        used += 1
        if above[waiting] >= 0:
            other[above[waiting]] = here
        for axis in range(3):
            box[here, 0, axis], box[here, 1, axis] = np.inf, -np.inf
            for t in range(first, last):
                for i in range(3):
                    box[here, 0, axis] = min(box[here, 0, axis], corner[t, i, axis])
                    box[here, 1, axis] = max(box[here, 1, axis], corner[t, i, axis])
        if last - first <= LEAF:
            other[here], count[here] = first, last - first
            continue
        middle = (first + last) // 2
        begin[waiting], end[waiting], above[waiting] = middle, last, here
        begin[waiting + 1], end[waiting + 1], above[waiting + 1] = first, middle, -1
        waiting += 2
    return used


@native
def _search(
    begin: int,
    end: int,
    query: Array,
    corner: Array,
    box: Array,
    other: Array,
    count: Array,
    face: Array,
    weight: Array,
) -> None:
    """face (p,), in the order of the boxes, and weight (p, 3) of the points (p, 3)."""
    waiting, gap = np.empty(DEEP, np.int64), np.empty(DEEP)
    winner = 0
    for p in range(begin, end):
        x, y, z = query[p, 0], query[p, 1], query[p, 2]
        best, u, v, w = _closest(x, y, z, corner[winner])
        waiting[0], gap[0] = 0, _beyond(x, y, z, box[0])
        depth = 1
        while depth:
            depth -= 1
            if gap[depth] >= best:
                continue
            b = waiting[depth]
            if count[b]:
                for t in range(other[b], other[b] + count[b]):
                    square, of_a, of_b, of_c = _closest(x, y, z, corner[t])
                    if square < best:
                        best, winner, u, v, w = square, t, of_a, of_b, of_c
                continue
            near, far = b + 1, other[b]
            near_gap, far_gap = _beyond(x, y, z, box[near]), _beyond(x, y, z, box[far])
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            waiting[depth], gap[depth] = far, far_gap
            waiting[depth + 1], gap[depth + 1] = near, near_gap
            depth += 2
        face[p] = winner
        weight[p, 0], weight[p, 1], weight[p, 2] = u, v, w


@native
def _beyond(x: float, y: float, z: float, box: Array) -> float:
    """Squared distance to a box (2, 3)."""
    dx = max(box[0, 0] - x, x - box[1, 0], 0.0)
    dy = max(box[0, 1] - y, y - box[1, 1], 0.0)
    dz = max(box[0, 2] - z, z - box[1, 2], 0.0)
    return dx * dx + dy * dy + dz * dz


@native
def _closest(x: float, y: float, z: float, corner: Array) -> tuple[float, float, float, float]:
    """Squared distance and barycentrics of one point: ops/triangle.py, step by step."""
    ax, ay, az = corner[0, 0], corner[0, 1], corner[0, 2]
    abx, aby, abz = corner[1, 0] - ax, corner[1, 1] - ay, corner[1, 2] - az
    acx, acy, acz = corner[2, 0] - ax, corner[2, 1] - ay, corner[2, 2] - az
    apx, apy, apz = x - ax, y - ay, z - az
    bcx, bcy, bcz = acx - abx, acy - aby, acz - abz
    bpx, bpy, bpz = apx - abx, apy - aby, apz - abz
    ab2, ac2, bc2 = (
        abx * abx + aby * aby + abz * abz,
        acx * acx + acy * acy + acz * acz,
        bcx * bcx + bcy * bcy + bcz * bcz,
    )
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    area2, longest = nx * nx + ny * ny + nz * nz, max(ab2, ac2, bc2)
    if area2 > (THIN * longest) ** 2:
        v = ((apy * acz - apz * acy) * nx + (apz * acx - apx * acz) * ny + (apx * acy - apy * acx) * nz) / area2
        w = ((aby * apz - abz * apy) * nx + (abz * apx - abx * apz) * ny + (abx * apy - aby * apx) * nz) / area2
        u = 1 - v - w
        if min(v, w, u) >= 0:
            height = apx * nx + apy * ny + apz * nz
            return height * height / area2, u, v, w
    on_ab = min(max((apx * abx + apy * aby + apz * abz) / max(ab2, TINY), 0.0), 1.0)
    on_ac = min(max((apx * acx + apy * acy + apz * acz) / max(ac2, TINY), 0.0), 1.0)
    on_bc = min(max((bpx * bcx + bpy * bcy + bpz * bcz) / max(bc2, TINY), 0.0), 1.0)
    square_ab = (apx - on_ab * abx) ** 2 + (apy - on_ab * aby) ** 2 + (apz - on_ab * abz) ** 2
    square_ac = (apx - on_ac * acx) ** 2 + (apy - on_ac * acy) ** 2 + (apz - on_ac * acz) ** 2
    square_bc = (bpx - on_bc * bcx) ** 2 + (bpy - on_bc * bcy) ** 2 + (bpz - on_bc * bcz) ** 2
    best = min(square_ab, square_ac, square_bc)
    if square_ab <= best:
        return best, 1 - on_ab, on_ab, 0.0
    if square_ac <= best:
        return best, 1 - on_ac, 0.0, on_ac
    return best, 0.0, 1 - on_bc, on_bc
