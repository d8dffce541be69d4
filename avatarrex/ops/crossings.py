"""The winding number of a closed mesh by signed crossings, in compiled loops on a CPU (ops/native.py): exact, float64.

w(p) = Σ over the triangles that the ray p + t·z, t > 0 meets of the sign of their normal's z: an integer, also where the mesh
passes through itself. The ray walks the boxes of a `TriangleTree`. An edge's line is evaluated from its end of lower x (then y) by both
of its triangles, to the same rounded number, and a ray on it lies to its left: as if all rays were moved up y by nothing, so that those
through edges and corners are counted once, too. `winding_number` (ops/pseudonormal.py) is the reference.

Letters: p points, f faces, b boxes. Metres.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from avatarrex.ops.closest_tree import DEEP, TriangleTree
from avatarrex.ops.native import native, spread

Array = Shaped[np.ndarray, "..."]


@torch.no_grad()
def winding(tree: TriangleTree, points: Float[Tensor, "p 3"]) -> Int[Tensor, " p"]:
    """How many times the closed mesh wraps each point."""
    query, found = points.detach().double().contiguous().numpy(), np.empty(len(points), np.int64)
    spread(_count, len(query), query, tree.corner, tree.box, tree.other, tree.count, found)
    return torch.from_numpy(found)


@native
def _count(
    begin: int, end: int, query: Array, corner: Array, box: Array, other: Array, count: Array, found: Array
) -> None:
    waiting = np.empty(DEEP, np.int64)
    for p in range(begin, end):
        x, y, z = query[p, 0], query[p, 1], query[p, 2]
        total, depth = 0, 1
        waiting[0] = 0
        while depth:
            depth -= 1
            b = waiting[depth]
            if x < box[b, 0, 0] or x > box[b, 1, 0] or y < box[b, 0, 1] or y > box[b, 1, 1] or z > box[b, 1, 2]:
                continue
            if not count[b]:
                waiting[depth], waiting[depth + 1] = other[b], b + 1
                depth += 2
            for t in range(other[b], other[b] + count[b]):
                total += _crossing(x, y, z, corner, t)
        found[p] = total


@native
def _crossing(x: float, y: float, z: float, corner: Array, t: int) -> int:
    """1 where the ray leaves through triangle t, −1 where it enters, 0 where it misses."""
    left = _left(x, y, corner, t, 0, 1)
    if _left(x, y, corner, t, 1, 2) != left or _left(x, y, corner, t, 2, 0) != left:
        return 0
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    abx, aby, abz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    acx, acy, acz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    above = (nx * (x - ax) + ny * (y - ay) + nz * (z - az)) * (1.0 if left else -1.0)
    if above >= 0:  # the point, over the triangle
        return 0
    return 1 if left else -1


@native
def _left(x: float, y: float, corner: Array, t: int, i: int, j: int) -> bool:
    """Whether the triangle's shadow edge from corner i to j has (x, y) on its left."""
    turned = corner[t, i, 0] > corner[t, j, 0] or (
        corner[t, i, 0] == corner[t, j, 0] and corner[t, i, 1] > corner[t, j, 1]
    )
    if turned:
        i, j = j, i
    ax, ay = corner[t, i, 0], corner[t, i, 1]
    side = (corner[t, j, 0] - ax) * (y - ay) - (corner[t, j, 1] - ay) * (x - ax)
    return (side >= 0) != turned
