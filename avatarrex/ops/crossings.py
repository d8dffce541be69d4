"""The winding number of a closed mesh by signed crossings, in compiled loops on a CPU (ops/native.py): exact, float64.

w(p) = Σ over the triangles that the ray p + t·z, t > 0 meets of the sign of their normal's z: an integer, also where the mesh
passes through itself. The ray walks a tree of triangles (search_tree.py). An edge's line is evaluated from its end of lower x (then
y) by both of its triangles, to the same rounded number, and a ray on it lies to its left: as if all rays were moved up y by nothing,
so that those through edges and corners are counted once, too. `winding_number` (ops/pseudonormal.py) is the reference; it also serves
open meshes and those with repeated triangles.

Letters: p points, f faces, b boxes. Metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.native import borrowing, native, spread
from avatarrex.ops.search_tree import Point, SearchTree, finite, new_stack, specialised

Array = Shaped[np.ndarray, "..."]


def winding(tree: SearchTree, points: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
    """How many times the closed mesh wraps each point."""
    query, found = finite(points), np.empty(len(points), np.int64)
    spread(_count, len(query), query, tree, found)
    return found


@borrowing
def _ray_gap(box: Array, b: int, point: Point) -> float:
    """0 where the ray may meet box b of (b, 2, 3), else ∞."""
    x, y, z = point
    missed = x < box[b, 0, 0] or x > box[b, 1, 0] or y < box[b, 0, 1] or y > box[b, 1, 1] or z > box[b, 1, 2]
    return np.inf if missed else 0.0


@borrowing
def left_of(x: float, y: float, corner: Array, t: int, i: int, j: int) -> bool:
    """Whether the triangle's shadow edge from corner i to j has (x, y) on its left."""
    turned = corner[t, i, 0] > corner[t, j, 0] or (
        corner[t, i, 0] == corner[t, j, 0] and corner[t, i, 1] > corner[t, j, 1]
    )
    if turned:
        i, j = j, i
    ax, ay = corner[t, i, 0], corner[t, i, 1]
    side = (corner[t, j, 0] - ax) * (y - ay) - (corner[t, j, 1] - ay) * (x - ax)
    return bool((side >= 0) != turned)


@borrowing
def _crossing(corner: Array, t: int, point: Point) -> int:
    """1 where the ray leaves through triangle t, −1 where it enters, 0 where it misses."""
    x, y, z = point
    left = left_of(x, y, corner, t, 0, 1)
    if left_of(x, y, corner, t, 1, 2) != left or left_of(x, y, corner, t, 2, 0) != left:
        return 0
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    abx, aby, abz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    acx, acy, acz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    above = (nx * (x - ax) + ny * (y - ay) + nz * (z - az)) * (1.0 if left else -1.0)
    if above >= 0:  # the point, over the triangle
        return 0
    return 1 if left else -1


@borrowing
def _add(tree: SearchTree, t: int, point: Point, _: Any, state: Any) -> Any:
    """State: limit and sum of the crossings."""
    return state[0], state[1] + _crossing(tree.corner, t, point)


_walk = specialised(_ray_gap, _add)


@native
def _count(begin: int, end: int, query: Array, tree: SearchTree, found: Array) -> None:
    """found (p,) of the points (p, 3)."""
    stack = new_stack()
    for p in range(begin, end):
        point, found[p] = (query[p, 0], query[p, 1], query[p, 2]), 0
        if _ray_gap(tree.box, 0, point) == 0:
            found[p] = _walk(tree, point, stack, (), (np.inf, 0))[1]
