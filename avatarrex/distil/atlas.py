"""The texture atlas of a surface, and which place of the mesh each texel is.

Letters: v vertices, t texture vertices, f faces, x texels inside charts, h w texels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xatlas
from jaxtyping import Bool, Float32, Int, Int32
from scipy.ndimage import distance_transform_edt

from avatarrex.camera import Camera
from avatarrex.capture.zbuffer import visible_faces

SIDE = 2048
"""Texels: about 1 mm on the body."""
FINER = (1.0, 1.5, 1.5, 2.5)
"""How much smaller a texel is on the body, the hands and the face."""
PADDING = 4
"""Texels between charts: two levels of mipmaps."""


@dataclass(frozen=True)
class Atlas:
    """Texture coordinates in the layout of `Surface`."""

    uv: Float32[np.ndarray, "t 2"]
    uv_vertex: Int32[np.ndarray, " t"]
    uv_faces: Int32[np.ndarray, "f 3"]


@dataclass(frozen=True)
class Texels:
    """The texels whose centre is inside a chart."""

    inside: Bool[np.ndarray, "h w"]
    face: Int[np.ndarray, " x"]
    barycentric: Float32[np.ndarray, "x 3"]

    def interpolated(self, faces: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Vertex values (v, …) at the texels (x, …)."""
        corners = faces[self.face]
        return np.asarray(sum(self.barycentric[:, k, None] * values[corners[:, k]] for k in range(3)))

    def image(self, values: np.ndarray) -> np.ndarray:
        """(x, c) as (h, w, c), with the nearest chart's colours between the charts."""
        out = np.zeros((*self.inside.shape, values.shape[1]), values.dtype)
        out[self.inside] = values
        nearest = distance_transform_edt(~self.inside, return_distances=False, return_indices=True)
        return np.asarray(out[tuple(nearest)])


def make_atlas(vertices: np.ndarray, faces: np.ndarray, part: np.ndarray) -> Atlas:
    """Charts of each part with its own density, packed into one square; the vertices (v, 3) in metres at rest."""
    atlas = xatlas.Atlas()
    owner = part[faces].max(1)
    pieces = [np.flatnonzero(owner == number) for number in np.unique(owner)]
    for rows in pieces:
        used, local = np.unique(faces[rows], return_inverse=True)
        scaled = vertices[used] * FINER[owner[rows[0]]]
        atlas.add_mesh(scaled.astype(np.float32), local.reshape(-1, 3).astype(np.uint32))
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding, pack.bilinear, pack.create_image = SIDE, PADDING, True, False
    atlas.generate(xatlas.ChartOptions(), pack)
    uv, uv_vertex, start = [], [], 0
    uv_faces = np.zeros_like(faces)
    for number, rows in enumerate(pieces):
        mapping, local, coordinates = atlas[number]
        uv_faces[rows] = local + start
        uv.append(coordinates)
        uv_vertex.append(np.unique(faces[rows])[mapping])
        start += len(mapping)
    return Atlas(
        np.concatenate(uv).astype(np.float32), np.concatenate(uv_vertex).astype(np.int32), uv_faces.astype(np.int32)
    )


def texels(atlas: Atlas, side: int = SIDE) -> Texels:
    """The place on the mesh of every texel of a square texture."""
    flat = np.concatenate([atlas.uv * side, np.ones((len(atlas.uv), 1))], 1).astype(np.float64)
    face, barycentric, _ = visible_faces(flat, atlas.uv_faces, Camera(np.eye(3), np.eye(4), side, side))
    inside = face >= 0
    return Texels(inside, face[inside], barycentric[inside].astype(np.float32))
