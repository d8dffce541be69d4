"""Exact signed distance to the outer surface of a union of closed solids (docs/subject.md).

Inside means winding number > ½ over all solids together (ops/crossings.py): pseudonormals are wrong inside self-
intersections and between layers. Outside, the nearest point of *any* triangle is on the outer surface, for a segment
that ended on a buried one would have met the outer surface before: the distance is exact. Inside, buried triangles
must not count. A triangle is buried when its three corners, lifted 0.2 mm along their normals, lie inside the union;
one that straddles an intersection stays whole, so that the depth just below an intersection line is too small there,
by at most one triangle's width (4 to 9 mm on cloth).

libigl does the nearest-triangle search (extra `sdf`). Letters: v vertices, f faces, p points. Metres, float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.ops.crossings import winding
from avatarrex.ops.search_tree import SearchTree

LIFT = 2e-4
"""Metres that a point is lifted off the surface to see whether it is buried: far above rounding, far below any cloth's thickness."""


def libigl() -> Any:
    """The libigl module, or an `InputError` that names the extra."""
    try:
        import igl
    except ImportError:
        raise InputError(
            "subject", "libigl", "the extra `sdf`: pip install 'avatarrex-studio[sdf]'", "not installed"
        ) from None
    return igl


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
        corners = self.vertices[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        flat = self.faces.ravel()
        lift = np.stack([np.bincount(flat, np.repeat(normal[:, k], 3), len(self.vertices)) for k in range(3)], 1)
        lift *= LIFT / np.maximum(np.linalg.norm(lift, axis=1, keepdims=True), 1e-20)
        showing = self.winding(self.vertices + lift) < 0.5
        return np.flatnonzero(showing[self.faces].any(1) & (area > 1e-14))

    @cached_property
    def _tree(self) -> tuple[Any, np.ndarray]:
        outer_faces = np.ascontiguousarray(self.faces[self.outer])
        tree = libigl().AABB()
        tree.init(self.vertices, outer_faces)
        return tree, outer_faces

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nearest point of the outer surface: distance (p,), face (p,), barycentrics (p, 3)."""
        tree, outer_faces = self._tree
        squared, face, nearest = tree.squared_distance(self.vertices, outer_faces, _points(points))
        face = self.outer[np.asarray(face).reshape(-1)]
        return np.sqrt(squared).reshape(-1), face, barycentric(self.vertices[self.faces[face]], np.asarray(nearest))

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """(p,) metres to the outer surface, negative inside the union."""
        points = _points(points)
        distance, _, _ = self.closest(points)
        return np.where(self.winding(points) > 0, -distance, distance)

    def sample(self, count: int, rng: np.random.Generator, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Area-uniform points of triangles `ids` on the outer surface: face (count,), barycentrics (count, 3)."""
        corners = self.vertices[self.faces[ids]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        if not area.sum() > 0:
            raise InputError("subject", "sample", "a part that shows on the outer surface", "none of it")
        faces, weights = np.empty(0, dtype=np.int64), np.empty((0, 3))
        for _ in range(64):
            pick = rng.choice(len(ids), count, p=area / area.sum())
            root, v = np.sqrt(rng.random(count)), rng.random(count)
            bary = np.stack([1 - root, root * (1 - v), root * v], 1)
            lifted = np.einsum("pk,pkc->pc", bary, corners[pick]) + LIFT * normal[pick] / area[pick, None]
            shows = self.winding(lifted) < 1
            faces, weights = np.r_[faces, ids[pick[shows]]], np.r_[weights, bary[shows]]
            if len(faces) >= count:
                return faces[:count], weights[:count]
        raise InputError(
            "subject", "sample", "a part that shows on the outer surface", f"{len(faces)} of {count} points"
        )


def barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(p, 3) weights of `points` in triangles `corners` (p, 3, 3), clamped to the triangle; finite on slivers."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    area = np.maximum(uu * vv - uv * uv, 1e-30)
    second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    weights: np.ndarray = np.clip(np.stack([1 - second - third, second, third], 1), 0, 1)
    weights /= weights.sum(1, keepdims=True)
    return weights


def _points(points: np.ndarray) -> np.ndarray:
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError("points", "", "shape (p, 3)", points.shape)
    return points
