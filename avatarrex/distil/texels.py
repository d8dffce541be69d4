"""Which place of the mesh each texel of an atlas is.

Letters: v vertices, t texture vertices, f faces, x texels inside charts, h w texels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int
from scipy.ndimage import distance_transform_edt

from avatarrex.camera import Camera
from avatarrex.capture.zbuffer import visible_faces


@dataclass(frozen=True)
class Texels:
    """The texels whose centre is inside a chart."""

    inside: Bool[np.ndarray, "h w"]
    face: Int[np.ndarray, " x"]
    barycentric: Float32[np.ndarray, "x 3"]

    def interpolated(self, faces: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Vertex values (v, c) at the texels (x, c)."""
        corners = faces[self.face]
        a, b, c = (self.barycentric[:, k, None] * values[corners[:, k]] for k in range(3))
        return np.asarray(a + b + c)

    def image(self, values: np.ndarray) -> np.ndarray:
        """(x, c) as (h, w, c), with the nearest chart's values between the charts, so that filtering across a seam finds no edge."""
        out = np.zeros((*self.inside.shape, values.shape[1]), values.dtype)
        out[self.inside] = values
        nearest = distance_transform_edt(~self.inside, return_distances=False, return_indices=True)
        return np.asarray(out[tuple(nearest)])


def texels(uv: Float32[np.ndarray, "t 2"], uv_faces: Int[np.ndarray, "f 3"], height: int, width: int) -> Texels:
    """The place on the mesh of every texel of a texture."""
    flat = np.concatenate([uv * [width, height], np.ones((len(uv), 1))], 1).astype(np.float64)
    face, barycentric, _ = visible_faces(flat, uv_faces, Camera(np.eye(3), np.eye(4), width, height))
    inside = face >= 0
    return Texels(inside, face[inside], barycentric[inside].astype(np.float32))
