"""The closest vertex of a cloud, or several, by a search tree (search_tree.py) in compiled loops: exact, float64.

Searches start from what was closest to the point before, for points of a lattice lie in order. One: of equals the first. Several:
any of equals. Letters: p points, v vertices, m vertices found of a point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.native import borrowing, native, spread
from avatarrex.ops.search_tree import Point, SearchTree, finite, new_stack, point_gap, specialised

LARGER, TINY = 1 + 1e-15, float(np.finfo(np.float64).tiny)
Array = Shaped[np.ndarray, "..."]


def closest_vertex(
    tree: SearchTree, position: Float[np.ndarray, "p 3"], within: float = np.inf
) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Distances, metres, and numbers of the vertices; ∞ and any number where none is closer than `within`."""
    query = finite(position)
    distance, vertex = np.empty(len(query)), np.empty(len(query), np.int64)
    spread(_closest, len(query), query, tree, float(within), distance, vertex)
    return distance, vertex


def closest_vertices(
    tree: SearchTree, position: Float[np.ndarray, "p 3"], count: int
) -> tuple[Float[np.ndarray, "p m"], Int[np.ndarray, "p m"]]:
    """Distances, metres, and numbers of the `count` closest vertices, nearest first. Raises ValueError for too few."""
    query = finite(position)
    if not 0 < count <= len(tree.corner):
        raise ValueError(f"{count} of {len(tree.corner)} vertices")
    square, vertex = np.full((len(query), count), np.inf), np.full((len(query), count), -1)
    spread(_several, len(query), query, tree, square, vertex)
    return np.sqrt(square), vertex


@borrowing
def _square(tree: SearchTree, k: int, point: Point) -> float:
    x, y, z = point
    dx, dy, dz = tree.corner[k, 0, 0] - x, tree.corner[k, 0, 1] - y, tree.corner[k, 0, 2] - z
    return float(dx**2 + dy**2 + dz**2)


@borrowing
def _beyond(square: float) -> float:
    """A limit past that distance: a box as far off may contain an equal."""
    return square * LARGER + TINY


@borrowing
def _first_of_equals(tree: SearchTree, k: int, point: Point, _: Any, state: Any) -> Any:
    """State: limit, squared distance and leaf of the closest, and whether there is one.

    What changes nothing leaves first: a jump that is foreseen, where selected numbers would wait for one another.
    """
    limit, best, winner, known = state
    square = _square(tree, k, point)
    if square > best or (square == best and not (known and tree.number[k] < tree.number[winner])):
        return limit, best, winner, known
    return _beyond(square), square, k, True


@borrowing
def _insert(tree: SearchTree, k: int, point: Point, out: Any, state: Any) -> Any:
    """State: limit, and the row of `out`: squared distances (p, m), sorted, and leaves (p, m), each of them once."""
    limit, p = state
    square, found = out
    here, m = _square(tree, k, point), square.shape[1] - 1
    if here >= limit:
        return limit, p
    for there in range(m + 1):
        if found[p, there] == k:
            return limit, p
    while m and here < square[p, m - 1]:
        square[p, m], found[p, m] = square[p, m - 1], found[p, m - 1]
        m -= 1
    square[p, m], found[p, m] = here, k
    return square[p, -1], p


_walk_to_closest = specialised(point_gap, _first_of_equals)
_walk_to_several = specialised(point_gap, _insert)


@native
def _closest(
    begin: int, end: int, query: Array, tree: SearchTree, within: float, distance: Array, found: Array
) -> None:
    """distance (p,) and found (p,) of the points (p, 3)."""
    stack, winner = new_stack(), 0
    for p in range(begin, end):
        point = query[p, 0], query[p, 1], query[p, 2]
        best = _square(tree, winner, point)
        known = best < within**2
        if not known:
            best = within**2
        _, best, winner, known = _walk_to_closest(tree, point, stack, (), (_beyond(best), best, winner, known))
        distance[p], found[p] = np.sqrt(best) if known else np.inf, tree.number[winner]


@native
def _several(begin: int, end: int, query: Array, tree: SearchTree, square: Array, found: Array) -> None:
    """square (p, m), all ∞ before, and found (p, m), all −1 before, of the points (p, 3)."""
    stack, out = new_stack(), (square, found)
    for p in range(begin, end):
        point, state = (query[p, 0], query[p, 1], query[p, 2]), (np.inf, p)
        if p > begin:
            for m in range(found.shape[1]):
                state = _insert(tree, found[p - 1, m], point, out, state)
        _walk_to_several(tree, point, stack, out, state)
    for p in range(begin, end):
        for m in range(found.shape[1]):
            found[p, m] = tree.number[found[p, m]]
