"""The first triangle under each pixel: a z-buffer on the CPU, without OpenGL.

The reference of the capture's rasteriser, and what silhouettes are compared by. Letters: h w pixels, v vertices,
f faces. Metres, OpenCV camera, pixel centres at +0.5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Shaped

from avatarrex.camera import Camera
from avatarrex.ops.native import native

NEAREST_DEPTH = 0.02
"""Metres: triangles that reach nearer to the camera are dropped."""

Array = Shaped[np.ndarray, "..."]


def visible_faces(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First triangle under each pixel centre; of those that are equally far the one whose box of pixels is smaller.

    Returns face (h, w) with −1 on the background, perspective-correct barycentrics (h, w, 3), camera z (h, w) in m.
    """
    height, width = camera.height, camera.width
    pixels, depth = camera.pixels(vertices, nearest=NEAREST_DEPTH)
    corners = pixels[faces]
    a, b, c = corners.swapaxes(0, 1)
    low = np.maximum(np.ceil(np.minimum(np.minimum(a, b), c) - 0.5).astype(np.int64), 0)
    high = np.minimum(np.floor(np.maximum(np.maximum(a, b), c) - 0.5).astype(np.int64), [width - 1, height - 1])
    kept = np.flatnonzero((depth[faces] > NEAREST_DEPTH).all(1) & (high >= low).all(1))
    order = kept[np.argsort((high - low + 1)[kept].prod(1), kind="stable")]
    face, bary, z = np.full((height, width), -1), np.zeros((height, width, 3)), np.full((height, width), np.inf)
    _draw(order, corners, depth[faces], low, high, face, bary, z)
    return face, bary, z


@native
def _draw(
    order: Array, corners: Array, depth: Array, low: Array, high: Array, face: Array, bary: Array, best: Array
) -> Any:
    """Triangles `order` into `face`, `bary` and `best` z: `corners` (f, 3, 2) in pixels, `depth` (f, 3), boxes of pixels (f, 2)."""
    for f in order:
        (ax, ay), (bx, by), (cx, cy) = corners[f]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        for row in range(low[f, 1], high[f, 1] + 1):
            y = row + 0.5
            for column in range(low[f, 0], high[f, 0] + 1):
                x = column + 0.5
                one = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / area
                two = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / area
                three = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                if one < 0 or two < 0 or three < 0:
                    continue
                one, two, three = one / depth[f, 0], two / depth[f, 1], three / depth[f, 2]
                z = 1 / (one + two + three)
                if z < best[row, column]:
                    best[row, column], face[row, column] = z, f
                    bary[row, column, 0], bary[row, column, 1], bary[row, column, 2] = one * z, two * z, three * z
