"""Winding number of closed solids at points, exactly, by signed crossings of a ray (default_person.md, the sign of the union).

For closed surfaces w(p) = Σ over the triangles that the ray p + t·z, t > 0 meets of the sign of their normal's z: an integer,
whatever the solids' overlaps. Triangles are binned by their shadow in the xy plane, so that a point looks at a few dozen.
Each shadow edge is tested with its ends in index order: both neighbours of an edge see the same rounded number, so that a ray
through an edge or a vertex is counted exactly once (half-open rule) and no tolerance is needed.

Letters: f faces, p points, k (point, triangle) pairs. Metres, float64.
"""

from __future__ import annotations

import numpy as np

CELL = 0.006
"""Metres: bins about as wide as a cloth triangle."""
CHUNK = 3_000_000
"""Pairs held at once, about 500 MB."""


class RayWinding:
    """Bins of a closed triangle set."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces = faces
        shadow = self.vertices[faces][:, :, :2]
        self.low = self.vertices[:, :2].min(0) - CELL
        first = ((shadow.min(1) - self.low) / CELL).astype(np.int64)
        count = ((shadow.max(1) - self.low) / CELL).astype(np.int64) - first + 1
        self.width, self.height = (first + count).max(0).tolist()
        owner, inner = _expand(count.prod(1))
        x = first[owner, 0] + inner % count[owner, 0]
        y = first[owner, 1] + inner // count[owner, 0]
        cell = y * self.width + x
        order = np.argsort(cell, kind="stable")
        self.triangles = owner[order]
        self.start = np.searchsorted(cell[order], np.arange(self.width * self.height + 1))
        self.top = self.vertices[faces][:, :, 2].max(1)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(p,) int64: how many times the solids wrap each point."""
        total = np.zeros(len(points), dtype=np.int64)
        column = np.floor((points[:, :2] - self.low) / CELL).astype(np.int64)
        inside = ((column >= 0) & (column < [self.width, self.height])).all(1)
        ids = np.flatnonzero(inside)
        cell = column[ids, 1] * self.width + column[ids, 0]
        count = self.start[cell + 1] - self.start[cell]
        edges = np.searchsorted(np.cumsum(count), np.arange(0, max(count.sum(), 1), CHUNK))
        for a, b in zip(edges, [*edges[1:], len(ids)]):
            owner, inner = _expand(count[a:b])
            triangle = self.triangles[self.start[cell[a:b]][owner] + inner]
            point = ids[a:b][owner]
            high = self.top[triangle] > points[point, 2]
            point, triangle = point[high], triangle[high]
            total += np.bincount(point, self._crossing(points[point], triangle), len(points)).astype(np.int64)
        return total

    def _crossing(self, point: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """(k,) +1 where the upward ray leaves through the triangle, −1 where it enters, 0 where it misses."""
        corner = self.faces[triangle]
        side = [self._side(point, corner[:, i], corner[:, (i + 1) % 3]) for i in range(3)]
        left = [s >= 0 for s in side]
        hit = (left[0] == left[1]) & (left[1] == left[2])
        point, corner, sign = point[hit], corner[hit], np.where(left[0][hit], 1.0, -1.0)
        weight = np.abs(np.stack([side[1][hit], side[2][hit], side[0][hit]], 1))
        height = (weight * self.vertices[corner][:, :, 2]).sum(1) / np.maximum(weight.sum(1), 1e-300)
        crossing = np.zeros(len(hit))
        crossing[hit] = sign * (height > point[:, 2])
        return crossing

    def _side(self, point: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Twice the signed shadow area of (a, b, point), from the lower index to the higher; zero counts as −0 on the way back."""
        flip = a > b
        p, q = self.vertices[np.where(flip, b, a)], self.vertices[np.where(flip, a, b)]
        area = (q[:, 0] - p[:, 0]) * (point[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (point[:, 0] - p[:, 0])
        return np.where(flip, np.where(area == 0, -np.finfo(float).tiny, -area), area)


def _expand(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (n,): the owner of every unit, and its place within the owner."""
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
