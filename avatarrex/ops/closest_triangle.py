"""The closest triangle of a mesh and the side of it, by a search tree (search_tree.py) in compiled loops: exact, float64.

Each point starts from the triangle that was closest to the point before: points of a lattice or of a picture lie in order, and few
boxes are nearer. Which of the triangles of an edge is found depends on it, too. Where distances saturate, a point is not searched
when the point before it in the row is so far from the surface that both are beyond the bound: of a closed mesh they lie on the same
side.

Letters: p points, v vertices, f faces.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.native import borrowing, native, spread
from avatarrex.ops.pseudonormal import Pseudonormals
from avatarrex.ops.search_tree import Point, SearchTree, Stack, finite, new_stack, point_gap, specialised
from avatarrex.ops.triangle import THIN

BOUND_MARGIN = 0.04
"""Metres beyond the bound up to which all points are searched: what is looked up at them is interpolated with what lies within.
The diagonal of the coarsest cells of a hand's box (`volume/part_box.py`) at voxels of 5 mm."""
ON_SURFACE = 1e-30
"""Square metres: nearer, the distance is the height over the surface."""
TINY = float(np.finfo(np.float64).tiny)
Array = Shaped[np.ndarray, "..."]


class _Normals(NamedTuple):
    """`Pseudonormals` as arrays, with the faces (f, 3) that they belong to."""

    faces: Array
    face: Array
    edge: Array
    vertex: Array
    flat_face: Array
    flat_edge: Array
    flat_vertex: Array


class SignedClosest(NamedTuple):
    """The closest surface point of each point, and the side of it."""

    sdf: Array
    """(p,) metres, negative inside; not yet clamped to the bound."""
    face: Array
    """(p,)"""
    weight: Array
    """(p, 3) barycentrics."""
    unsure: Array
    """(p,) whether the sign is undefined there: `Pseudonormals.unsure`."""


def closest_triangle(
    tree: SearchTree, points: Float[np.ndarray, "p 3"]
) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 3"]]:
    """Closest face and the barycentrics of its closest point (float64, exact zeros off the feature that holds it)."""
    query = finite(points)
    face, weight = np.empty(len(query), np.int64), np.empty((len(query), 3))
    spread(_search, len(query), query, tree, face, weight)
    return face, weight


def signed_closest(
    tree: SearchTree,
    points: Float[np.ndarray, "p 3"],
    faces: Int[np.ndarray, "f 3"],
    normals: Pseudonormals,
    bound: tuple[float, float] | None = None,
) -> SignedClosest:
    """`closest_triangle` with the sign of the pseudonormals.

    Of a point that is farther than `BOUND_MARGIN` beyond the bound: the bound, and the face of a point before it in the row.
    """
    query, count = finite(points), len(points)
    limits = (-np.inf, np.inf) if bound is None else (float(bound[0]), float(bound[1]))
    outward = (part.double().numpy() for part in (normals.face, normals.edge, normals.vertex))
    flat = (part.numpy() for part in (normals.flat_face, normals.flat_edge, normals.flat_vertex))
    found = SignedClosest(np.empty(count), np.empty(count, np.int64), np.empty((count, 3)), np.empty(count, np.bool_))
    spread(_sign, count, query, tree, _Normals(faces, *outward, *flat), limits, found)
    return found


@borrowing
def on_triangle(corner: Array, t: int, point: Point) -> tuple[float, float, float, float]:
    """Squared distance and barycentrics of the closest point of triangle t: ops/triangle.py, step by step."""
    x, y, z = point
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    abx, aby, abz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    acx, acy, acz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
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


@borrowing
def _nearer(tree: SearchTree, t: int, point: Point, _: Any, state: Any) -> Any:
    """State: squared distance, leaf and barycentrics of the closest triangle."""
    square, u, v, w = on_triangle(tree.corner, t, point)
    if square < state[0]:
        return square, t, u, v, w
    return state


_walk = specialised(point_gap, _nearer)


@native
def _search(begin: int, end: int, query: Array, tree: SearchTree, face: Array, weight: Array) -> None:
    """face (p,) and weight (p, 3) of the points (p, 3)."""
    stack, winner = new_stack(), 0
    for p in range(begin, end):
        point = query[p, 0], query[p, 1], query[p, 2]
        _, winner, u, v, w = closest_from(tree, winner, point, stack)
        face[p] = tree.number[winner]
        weight[p, 0], weight[p, 1], weight[p, 2] = u, v, w


@borrowing
def closest_from(tree: SearchTree, first: int, point: Point, stack: Stack) -> Any:
    """`_nearer`'s state of the closest triangle; the triangle `first` is tried before all."""
    square, u, v, w = on_triangle(tree.corner, first, point)
    return _walk(tree, point, stack, (), (square, first, u, v, w))


@borrowing
def _normal(normals: _Normals, f: int, u: float, v: float, w: float) -> tuple[float, float, float, bool]:
    """Pseudonormal of the feature that holds the point (u, v, w) of face f, and whether it is undefined."""
    zeros = (u <= 0) + (v <= 0) + (w <= 0)
    if zeros == 0:
        normal, flat = normals.face[f], normals.flat_face[f]
    elif zeros == 1:
        edge = 0 if u <= 0 else (1 if v <= 0 else 2)
        normal, flat = normals.edge[f, edge], normals.flat_edge[f, edge]
    else:
        vertex = normals.faces[f, 0 if u > 0 else (1 if v > 0 else 2)]
        normal, flat = normals.vertex[vertex], normals.flat_vertex[vertex]
    return normal[0], normal[1], normal[2], flat


@native
def _sign(
    begin: int,
    end: int,
    query: Array,
    tree: SearchTree,
    normals: _Normals,
    bound: tuple[float, float],
    out: SignedClosest,
) -> None:
    """`out` of the points (p, 3)."""
    stack, winner, u, v, w = new_stack(), 0, 1.0, 0.0, 0.0
    side, clear = 0.0, 0.0  # of the point before, and how far it at least is from the surface
    for p in range(begin, end):
        x, y, z = query[p, 0], query[p, 1], query[p, 2]
        if p > begin:
            clear -= math.sqrt((x - query[p - 1, 0]) ** 2 + (y - query[p - 1, 1]) ** 2 + (z - query[p - 1, 2]) ** 2)
        out.unsure[p] = False
        limit = bound[1] if side > 0 else -bound[0]
        if side != 0 and clear > limit + BOUND_MARGIN:
            out.sdf[p] = side * limit
        else:
            square, winner, u, v, w = closest_from(tree, winner, (x, y, z), stack)
            nx, ny, nz, out.unsure[p] = _normal(normals, tree.number[winner], u, v, w)
            on = tree.corner[winner]
            dx = x - (u * on[0, 0] + v * on[1, 0] + w * on[2, 0])
            dy = y - (u * on[0, 1] + v * on[1, 1] + w * on[2, 1])
            dz = z - (u * on[0, 2] + v * on[1, 2] + w * on[2, 2])
            height = dx * nx + dy * ny + dz * nz
            side, clear = 1.0 if height >= 0 else -1.0, math.sqrt(square)
            out.sdf[p] = side * clear
            if square <= ON_SURFACE:
                length = math.sqrt(nx**2 + ny**2 + nz**2)
                out.sdf[p] = height / length if length > 0 else 0.0
            if out.unsure[p]:
                side = 0.0
        out.face[p] = tree.number[winner]
        out.weight[p, 0], out.weight[p, 1], out.weight[p, 2] = u, v, w
