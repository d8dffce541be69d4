"""The triangle of a mesh that is met first from outside, as textures are baked with a cage, in compiled loops: exact, float64.

A ray goes inwards along the normal of another surface that lies near the mesh, from a little before the point on it to a little behind.
It meets what faces as that surface does. Where it meets nothing, the closest triangle that faces so takes its place.

Letters: p points, v vertices, f faces, b boxes. Metres.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.closest_triangle import closest_triangle, on_triangle
from avatarrex.ops.native import borrowing, native, spread
from avatarrex.ops.search_tree import SearchTree, finite, new_stack, point_gap, specialised

FACES = 0.3
"""Cosine between a triangle's normal and the surface's from which it faces as the surface does."""
NEARBY = 0.01**2
"""Square metres in which one that faces so is searched."""
Array = Shaped[np.ndarray, "..."]
Point = tuple[float, float, float]
Ray = tuple[float, float, float, float, float, float, float]
"""Place, unit direction, and the cosine from which a triangle faces it."""


def outer_triangle(
    tree: SearchTree,
    points: Float[np.ndarray, "p 3"],
    normals: Float[np.ndarray, "p 3"],
    reach: tuple[float, float],
    faces: float = FACES,
) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 3"]]:
    """Face and barycentrics of the first place that is met on the way from `reach[0]` metres before a point to `reach[1]` behind
    it, along its unit normal inwards; else of the closest place on what faces so, else of the closest one. What faces so has a normal
    whose cosine to the point's is above `faces`."""
    query, face, weight = finite(points), np.empty(len(points), np.int64), np.empty((len(points), 3))
    spread(_cast, len(query), query, finite(normals), tree, reach, faces, face, weight)
    missed = np.flatnonzero(face < 0)
    if len(missed):
        face[missed], weight[missed] = closest_triangle(tree, query[missed])
    return face, weight


@borrowing
def _ray_gap(box: Array, b: int, ray: Ray) -> float:
    """Metres along the ray to box b of (b, 2, 3), 0 within it; ∞ where it is missed."""
    enter, leave = 0.0, np.inf
    for axis in range(3):
        start, step = ray[axis], ray[axis + 3]
        low, high = box[b, 0, axis] - start, box[b, 1, axis] - start
        if step == 0:
            if low > 0 or high < 0:
                return np.inf
            continue
        near, far = low / step, high / step
        if near > far:
            near, far = far, near
        enter, leave = max(enter, near), min(leave, far)
    return enter if enter <= leave else np.inf


@borrowing
def _normal(corner: Array, t: int) -> tuple[float, float, float]:
    """Of triangle t, as long as twice its area."""
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    abx, aby, abz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    acx, acy, acz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
    return aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx


@borrowing
def _within(corner: Array, t: int, i: int, j: int, place: Point, normal: Point) -> float:
    """How far a place in the plane of triangle t is within its edge from corner i to j, times lengths; negative outside."""
    ax, ay, az = corner[t, i, 0], corner[t, i, 1], corner[t, i, 2]
    ex, ey, ez = corner[t, j, 0] - ax, corner[t, j, 1] - ay, corner[t, j, 2] - az
    px, py, pz = place[0] - ax, place[1] - ay, place[2] - az
    nx, ny, nz = normal
    return float((ey * pz - ez * py) * nx + (ez * px - ex * pz) * ny + (ex * py - ey * px) * nz)


@borrowing
def _meet(tree: SearchTree, t: int, ray: Ray, _: Any, state: Any) -> Any:
    """State: metres to the first meeting, its leaf and barycentrics."""
    corner, (x, y, z, dx, dy, dz, faces) = tree.corner, ray
    nx, ny, nz = _normal(corner, t)
    square, towards = nx * nx + ny * ny + nz * nz, -(nx * dx + ny * dy + nz * dz)
    if towards <= faces * math.sqrt(square):
        return state
    along = (nx * (x - corner[t, 0, 0]) + ny * (y - corner[t, 0, 1]) + nz * (z - corner[t, 0, 2])) / towards
    if not 0 <= along < state[0]:
        return state
    place, normal = (x + along * dx, y + along * dy, z + along * dz), (nx, ny, nz)
    v, w = _within(corner, t, 2, 0, place, normal) / square, _within(corner, t, 0, 1, place, normal) / square
    if min(v, w, 1 - v - w) < 0:
        return state
    return along, t, 1 - v - w, v, w


@borrowing
def _near(tree: SearchTree, t: int, point: Ray, _: Any, state: Any) -> Any:
    """State: squared distance, leaf and barycentrics of the closest triangle that faces as the surface does."""
    square, u, v, w = on_triangle(tree.corner, t, (point[0], point[1], point[2]))
    if square >= state[0]:
        return state
    nx, ny, nz = _normal(tree.corner, t)
    if nx * point[3] + ny * point[4] + nz * point[5] <= point[6] * math.sqrt(nx * nx + ny * ny + nz * nz):
        return state
    return square, t, u, v, w


@borrowing
def _gap(box: Array, b: int, point: Ray) -> float:
    """Squared distance of a point, before its normal, to box b of (b, 2, 3)."""
    return float(point_gap(box, b, (point[0], point[1], point[2])))


_ray_walk = specialised(_ray_gap, _meet)
_near_walk = specialised(_gap, _near)


@native
def _cast(
    begin: int,
    end: int,
    query: Array,
    normal: Array,
    tree: SearchTree,
    reach: tuple[float, float],
    faces: float,
    face: Array,
    weight: Array,
) -> None:
    """face (p,), −1 where there is none, and weight (p, 3) of the points (p, 3)."""
    stack = new_stack()
    for p in range(begin, end):
        x, y, z, nx, ny, nz = query[p, 0], query[p, 1], query[p, 2], normal[p, 0], normal[p, 1], normal[p, 2]
        ray = (x + reach[0] * nx, y + reach[0] * ny, z + reach[0] * nz, -nx, -ny, -nz, faces)
        _, t, u, v, w = _ray_walk(tree, ray, stack, (), (reach[0] + reach[1], -1, 0.0, 0.0, 0.0))
        if t < 0:
            _, t, u, v, w = _near_walk(tree, (x, y, z, nx, ny, nz, faces), stack, (), (NEARBY, -1, 0.0, 0.0, 0.0))
        face[p] = tree.number[t] if t >= 0 else -1
        weight[p, 0], weight[p, 1], weight[p, 2] = u, v, w
