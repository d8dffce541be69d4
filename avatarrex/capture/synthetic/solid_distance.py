"""Exact signed distance to the outer surface of a union of closed solids (docs/subject.md).

Inside means winding number > ½ over all solids together (ops/crossings.py): pseudonormals are wrong inside self-
intersections and between layers. Outside, the nearest point of *any* triangle is on the outer surface, for a segment
that ended on a buried one would have met the outer surface before: the distance is exact. Inside, buried triangles
must not count. A triangle is buried when its three corners, lifted 0.2 mm along their normals, lie inside the union;
one that straddles an intersection stays whole, so that the depth just below an intersection line is too small there,
by at most one triangle's width (4 to 9 mm on cloth).

The nearest triangle is found in a search tree (ops/closest_triangle.py). Letters: v vertices, f faces, p points. Metres, float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from avatarrex.capture.synthetic.mesh import face_normals, interpolated, vertex_normals
from avatarrex.errors import InputError
from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.crossings import winding
from avatarrex.ops.search_tree import SearchTree

LIFT_METRES = 2e-4
"""How far a point is lifted off the surface to see whether it is buried: far above rounding, far below any cloth's thickness."""


@dataclass(frozen=True)
class SolidUnion:
    """Closed solids in one vertex and face array; the order of solids does not matter."""

    vertices: np.ndarray
    """(v, 3) float64."""
    faces: np.ndarray
    """(f, 3) int64, outward."""

    @cached_property
    def _triangles(self) -> SearchTree:
        return SearchTree.of_triangles(self.vertices, self.faces)

    def winding(self, points: np.ndarray) -> np.ndarray:
        """(p,) how many of the solids contain each point: an integer, however they overlap."""
        return winding(self._triangles, points)

    @cached_property
    def outer(self) -> np.ndarray:
        """Indices (o,) of the triangles that show on the outer surface, at least at one corner."""
        lifted = self.vertices + LIFT_METRES * vertex_normals(self.vertices, self.faces)
        showing = self.winding(lifted) < 0.5
        area = np.linalg.norm(face_normals(self.vertices, self.faces), axis=1)
        return np.flatnonzero(showing[self.faces].any(1) & (area > 1e-14))

    @cached_property
    def _outer_triangles(self) -> SearchTree:
        return SearchTree.of_triangles(self.vertices, self.faces[self.outer])

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nearest point of the outer surface: distance (p,), face (p,), barycentrics (p, 3)."""
        points = _points(points)
        face, bary = closest_triangle(self._outer_triangles, points)
        face = self.outer[face]
        nearest = interpolated(bary, self.vertices[self.faces[face]])
        return np.linalg.norm(points - nearest, axis=1), face, bary

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """(p,) metres to the outer surface, negative inside the union."""
        distance, _, _ = self.closest(points)
        return np.where(self.winding(points) > 0, -distance, distance)

    def sample(self, count: int, rng: np.random.Generator, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Area-uniform points of triangles `ids` on the outer surface: face (count,), barycentrics (count, 3)."""
        corners, normal = self.vertices[self.faces[ids]], face_normals(self.vertices, self.faces[ids])
        area = np.linalg.norm(normal, axis=1)
        if not area.sum() > 0:
            raise InputError("subject", "sample", "a part that shows on the outer surface", "none of it")
        faces, weights = np.empty(0, dtype=np.int64), np.empty((0, 3))
        for _ in range(64):
            pick = rng.choice(len(ids), count, p=area / area.sum())
            root, v = np.sqrt(rng.random(count)), rng.random(count)
            bary = np.stack([1 - root, root * (1 - v), root * v], 1)
            lifted = interpolated(bary, corners[pick]) + LIFT_METRES * normal[pick] / area[pick, None]
            shows = self.winding(lifted) < 1
            faces, weights = np.r_[faces, ids[pick[shows]]], np.r_[weights, bary[shows]]
            if len(faces) >= count:
                return faces[:count], weights[:count]
        raise InputError(
            "subject", "sample", "a part that shows on the outer surface", f"{len(faces)} of {count} points"
        )


def _points(points: np.ndarray) -> np.ndarray:
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError("points", "", "shape (p, 3)", points.shape)
    return points
