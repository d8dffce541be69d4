"""The texture atlas of a surface.

Letters: t texture vertices, f faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xatlas
from jaxtyping import Float32, Int32

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
