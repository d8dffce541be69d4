"""How far a surface is from the true one: distances and normal angles both ways, and the overlap of silhouettes.

Both surfaces are what the cameras see of them: points under the pixels' centres. Avatar to truth: from sampled points of
the avatar to the nearest point of the true mesh. Truth to avatar: from sampled points of the true mesh to the nearest
point of the avatar's depth maps, triangulated. A normal angle is between the normals at both ends of such a distance.
Distances to triangles are exact (`ops/closest_triangle.py`).

Letters: p points, v vertices, f faces, h w pixels. World metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from avatarrex.camera import Camera
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.templates.mesh import vertex_normals

SURFACE_POINTS = 20_000
"""Points each way: the mean of distances that spread by 5 mm is then known to 0.04 mm."""
STEP_RATIO = 5.0
"""A depth map is cut where neighbours are further apart than this many pixel widths: a surface seen at over 78 degrees."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with smooth normals."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray) -> Surface:
        """A mesh with area-weighted vertex normals."""
        vertices, faces = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)
        return cls(vertices, faces, vertex_normals(torch.from_numpy(vertices), torch.from_numpy(faces)).numpy())

    @classmethod
    def joined(cls, surfaces: list[Surface]) -> Surface:
        """All in one."""
        first = np.cumsum([0] + [len(surface.vertices) for surface in surfaces])
        return cls(
            np.concatenate([surface.vertices for surface in surfaces]),
            np.concatenate([surface.faces + start for surface, start in zip(surfaces, first)]),
            np.concatenate([surface.normals for surface in surfaces]),
        )

    def seen_by(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Points (p, 3) and unit normals (p, 3) under the pixel centres of `camera`."""
        face, weight, _ = visible_faces(self.vertices, self.faces, camera)
        hit = face >= 0
        return self.at(face[hit], weight[hit])

    def at(self, face: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and unit normals at barycentrics `weight` (p, 3) of `face` (p,)."""
        corner = self.faces[face]
        point, normal = ((values[corner] * weight[..., None]).sum(1) for values in (self.vertices, self.normals))
        return point, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def distances(
    points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"], surface: Surface
) -> dict[str, float]:
    """From `points` with unit `normals` to the nearest points of `surface`.

    `mean_mm`, `p95_mm` (the 95th percentile) and `angle_deg` (the mean angle of the normals, 0 to 180).
    """
    face, weight = closest_triangle(SearchTree.of_triangles(surface.vertices, surface.faces), points)
    there, facing = surface.at(face, weight)
    distance = np.linalg.norm(points - there, axis=1)
    angle = np.arccos(np.clip((normals * facing).sum(1), -1, 1))
    return {
        "mean_mm": 1e3 * float(distance.mean()),
        "p95_mm": 1e3 * float(np.quantile(distance, 0.95)),
        "angle_deg": float(np.degrees(angle.mean())),
    }


def depth_surface(
    position: Float[np.ndarray, "h w 3"],
    normal: Float[np.ndarray, "h w 3"],
    hit: Bool[np.ndarray, "h w"],
    camera: Camera,
) -> Surface:
    """The points under a camera's pixels as triangles, cut at steps of depth."""
    index = np.full(hit.shape, -1)
    index[hit] = np.arange(hit.sum())
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    faces = faces[(faces >= 0).all(1)]
    vertices = position[hit].astype(np.float64)
    depth = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    longest = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, 1)], axis=2).max(1)
    pixel = depth[faces].min(1) / min(camera.intrinsics[0, 0], camera.intrinsics[1, 1])
    return Surface(vertices, faces[longest < STEP_RATIO * pixel], normal[hit].astype(np.float64))


def sampled(
    points: np.ndarray, normals: np.ndarray, count: int = SURFACE_POINTS, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """At most `count` of them, by chance, the same for the same seed."""
    if len(points) <= count:
        return points, normals
    chosen = np.random.default_rng(seed).choice(len(points), count, replace=False)
    return points[chosen], normals[chosen]


def silhouette_iou(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    """Intersection over union of two masks; NaN where both are empty."""
    union = int((a | b).sum())
    return float((a & b).sum() / union) if union else float("nan")
