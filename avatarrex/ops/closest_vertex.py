"""The closest vertex of a cloud, or several, by a tree of boxes, in compiled loops (ops/native.py): exact, float64.

`nearest` takes the first of equals, and starts from the vertex that was closest to the point before: those of a lattice lie
in order. `several` takes any of equals. Holds `beyond`, `fit` and `DEEP` of closest_tree.py, compiled. Letters: p points, v
vertices, b boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.closest_tree import DEEP, beyond, build, fit
from avatarrex.ops.native import native, spread

LEAF = 8
"""Vertices of a box that is not split."""
Array = Shaped[np.ndarray, "..."]


@dataclass(frozen=True)
class VertexTree:
    """A cloud of vertices, prepared."""

    vertex: Array
    """(v, 3) float64, in the order of the boxes."""
    number: Array
    """(v,) which is which."""
    box: Array
    """(b, 2, 3), and so on: closest_tree.py."""
    other: Array
    count: Array

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "v 3"]) -> VertexTree:
        """Of at least one vertex, metres. Raises ValueError for none, or NaN."""
        cloud = _finite(vertices)
        order, box, other, count = build(cloud[:, None], cloud, LEAF)
        return cls(cloud[order], order, box, other, count)

    def moved(self, vertices: Float[np.ndarray, "v 3"]) -> VertexTree:
        """The tree of the same vertices elsewhere: what a box holds stays, where it lies is found anew, in a tenth of the time.

        Far from where the boxes were made, searches take up to half as long again.
        """
        cloud = _finite(vertices)[self.number]
        box = np.empty_like(self.box)
        fit(cloud[:, None], np.arange(len(cloud)), box, self.other, self.count)
        return replace(self, vertex=cloud, box=box)

    def nearest(
        self, position: Float[np.ndarray, "p 3"], within: float = np.inf
    ) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Distances, metres, and numbers of the vertices; ∞ and any number where none is closer than `within`."""
        query = _finite(position)
        distance, vertex = np.empty(len(query)), np.empty(len(query), np.int64)
        tree = self.vertex, self.number, self.box, self.other, self.count
        spread(_nearest, len(query), query, *tree, float(within), distance, vertex)
        return distance, vertex

    def several(
        self, position: Float[np.ndarray, "p 3"], count: int
    ) -> tuple[Float[np.ndarray, "p m"], Int[np.ndarray, "p m"]]:
        """Distances, metres, and numbers of the `count` closest vertices, nearest first. Raises ValueError for too few."""
        query = _finite(position)
        if not 0 < count <= len(self.vertex):
            raise ValueError(f"{count} of {len(self.vertex)} vertices")
        square, vertex = np.full((len(query), count), np.inf), np.zeros((len(query), count), np.int64)
        tree = self.vertex, self.number, self.box, self.other, self.count
        spread(_several, len(query), query, *tree, square, vertex)
        return np.sqrt(square), vertex


def _finite(places: Array) -> Array:
    if not np.isfinite(places).all():
        raise ValueError("vertices and points must be finite")
    return np.ascontiguousarray(places, np.float64)


@native
def _nearest(
    begin: int,
    end: int,
    query: Array,
    vertex: Array,
    number: Array,
    box: Array,
    other: Array,
    count: Array,
    within: float,
    distance: Array,
    found: Array,
) -> None:
    """distance (p,) and found (p,) of the points (p, 3)."""
    waiting, gap = np.empty(DEEP, np.int64), np.empty(DEEP)
    winner = 0
    for p in range(begin, end):
        x, y, z = query[p, 0], query[p, 1], query[p, 2]
        best = (vertex[winner, 0] - x) ** 2 + (vertex[winner, 1] - y) ** 2 + (vertex[winner, 2] - z) ** 2
        known = best < within**2
        if not known:
            best = within**2
        b = depth = 0
        while True:
            if count[b]:
                for k in range(other[b], other[b] + count[b]):
                    square = (vertex[k, 0] - x) ** 2 + (vertex[k, 1] - y) ** 2 + (vertex[k, 2] - z) ** 2
                    if square < best or (known and square == best and number[k] < number[winner]):
                        best, winner, known = square, k, True
            else:
                near, far = b + 1, other[b]
                near_gap, far_gap = beyond(x, y, z, box, near), beyond(x, y, z, box, far)
                if far_gap < near_gap:
                    near, far, near_gap, far_gap = far, near, far_gap, near_gap
                if near_gap <= best:
                    waiting[depth], gap[depth] = far, far_gap
                    b, depth = near, depth + 1
                    continue
            while depth and gap[depth - 1] > best:
                depth -= 1
            if not depth:
                break
            depth -= 1
            b = waiting[depth]
        distance[p], found[p] = np.sqrt(best) if known else np.inf, number[winner]


@native
def _several(
    begin: int,
    end: int,
    query: Array,
    vertex: Array,
    number: Array,
    box: Array,
    other: Array,
    count: Array,
    square: Array,
    found: Array,
) -> None:
    """square (p, m), all ∞ before, and found (p, m) of the points (p, 3): a row is sorted as it fills."""
    waiting, gap = np.empty(DEEP, np.int64), np.empty(DEEP)
    last = square.shape[1] - 1
    for p in range(begin, end):
        x, y, z = query[p, 0], query[p, 1], query[p, 2]
        b = depth = 0
        while True:
            if count[b]:
                for k in range(other[b], other[b] + count[b]):
                    here = (vertex[k, 0] - x) ** 2 + (vertex[k, 1] - y) ** 2 + (vertex[k, 2] - z) ** 2
                    if here < square[p, last]:
                        m = last
                        while m and here < square[p, m - 1]:
                            square[p, m], found[p, m] = square[p, m - 1], found[p, m - 1]
                            m -= 1
                        square[p, m], found[p, m] = here, number[k]
            else:
                near, far = b + 1, other[b]
                near_gap, far_gap = beyond(x, y, z, box, near), beyond(x, y, z, box, far)
                if far_gap < near_gap:
                    near, far, near_gap, far_gap = far, near, far_gap, near_gap
                if near_gap < square[p, last]:
                    waiting[depth], gap[depth] = far, far_gap
                    b, depth = near, depth + 1
                    continue
            while depth and gap[depth - 1] >= square[p, last]:
                depth -= 1
            if not depth:
                break
            depth -= 1
            b = waiting[depth]
