"""Closest triangles of a mesh that does not move, by a table of cells: a tenth of a search's time.

A cell near the mesh has the triangle that is closest to its centre. From there a point walks over edges for as long as that brings it
nearer; one that ends at a corner, about which the next triangle lies may be hidden, is searched in the tree, bounded by what it has.
So a point that has two sheets at nearly the same distance may get the other one; it always gets the same.

Letters: f triangles, z y x cells, p points. Metres.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.closest_triangle import closest_from, closest_triangle, on_triangle
from avatarrex.ops.native import native, spread
from avatarrex.ops.search_tree import SearchTree, finite, new_stack

CELL = 0.01
"""Metres: smaller than most triangles of a body."""
NEAR = 0.06
"""Metres from the mesh within which cells are filled; beyond, the tree is searched."""
STEPS = 24
"""Over edges at most."""
Array = Shaped[np.ndarray, "..."]


class TriangleGrid(NamedTuple):
    """A mesh with its cells; triangles are the leaves of the tree, in its order."""

    tree: SearchTree
    beside: Array
    """(f, 3) the triangle over the edge opposite to each corner; −1: none."""
    cell: Array
    """(z, y, x) the closest triangle; −1 far from the mesh."""
    origin: Array
    """(3,) of the lowest cell's corner."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> TriangleGrid:
        """Of a mesh. Raises ValueError for none, or NaN."""
        tree = SearchTree.of_triangles(vertices, faces)
        low, high = (edge(vertices[faces].reshape(-1, 3), 0) for edge in (np.min, np.max))
        origin = low - NEAR
        size = np.ceil((high + NEAR - origin) / CELL).astype(int)
        cell = np.full(tuple(size[::-1]), -1, np.int32)
        filled = _about(vertices[faces], origin, cell.shape)
        centre = origin + CELL * (np.stack(np.unravel_index(filled, cell.shape), -1)[:, ::-1] + 0.5)
        leaf = np.empty(len(tree.number), np.int64)
        leaf[tree.number] = np.arange(len(leaf))
        cell.reshape(-1)[filled] = leaf[closest_triangle(tree, centre)[0]]
        return cls(tree, _beside(faces[tree.number]), cell, origin)

    def closest(self, points: Float[np.ndarray, "p 3"]) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 3"]]:
        """Face and barycentrics of each point."""
        query = finite(points)
        face, weight = np.empty(len(query), np.int64), np.empty((len(query), 3))
        spread(_walk_all, len(query), query, self, face, weight)
        return face, weight


def _about(corner: np.ndarray, origin: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Flat cells within `NEAR` of the triangles' corners and centres, more or less."""
    from scipy.ndimage import distance_transform_edt

    hit = np.ones(shape, bool)
    places = np.concatenate(
        [corner.reshape(-1, 3), corner.mean(1), *((corner + corner[:, [1, 2, 0]]) / 2).swapaxes(0, 1)]
    )
    index = np.floor((places - origin) / CELL).astype(int)
    hit[tuple(index.T[::-1])] = False
    return np.flatnonzero(distance_transform_edt(hit) * CELL < NEAR)


def _beside(faces: np.ndarray) -> Int[np.ndarray, "f 3"]:
    """Over the edge opposite to each corner; of an edge of more than two triangles one of the others."""
    edge = np.sort(faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
    order = np.lexsort(edge.T)
    same = (edge[order[1:]] == edge[order[:-1]]).all(1)
    one, other = order[:-1][same], order[1:][same]
    beside = np.full(len(edge), -1)
    beside[one], beside[other] = other // 3, one // 3
    return beside.reshape(-1, 3)


@native
def _walk_all(begin: int, end: int, query: Array, grid: Any, face: Array, weight: Array) -> None:
    """face (p,) and weight (p, 3) of the points (p, 3)."""
    tree, stack = grid.tree, new_stack()
    depth, height, width = grid.cell.shape
    for p in range(begin, end):
        point = query[p, 0], query[p, 1], query[p, 2]
        i = int(np.floor((point[0] - grid.origin[0]) / CELL))
        j = int(np.floor((point[1] - grid.origin[1]) / CELL))
        k = int(np.floor((point[2] - grid.origin[2]) / CELL))
        t = -1
        if 0 <= i < width and 0 <= j < height and 0 <= k < depth:
            t = grid.cell[k, j, i]
        far = t < 0
        t = max(t, 0)
        square, u, v, w = on_triangle(tree.corner, t, point)
        if not far:
            for _ in range(STEPS):
                moved = False
                for side in range(3):
                    share = u if side == 0 else (v if side == 1 else w)
                    other = grid.beside[t, side]
                    if share <= 0 and other >= 0:
                        there, a, b, c = on_triangle(tree.corner, other, point)
                        if there < square:
                            t, square, u, v, w, moved = other, there, a, b, c, True
                            break
                if not moved:
                    break
        if far or (u <= 0) + (v <= 0) + (w <= 0) > 1:
            square, t, u, v, w = closest_from(tree, t, point, stack)
        face[p] = tree.number[t]
        weight[p, 0], weight[p, 1], weight[p, 2] = u, v, w
