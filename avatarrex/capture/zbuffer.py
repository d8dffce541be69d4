"""The first triangle under each pixel: a z-buffer on the CPU, without OpenGL.

The reference of the capture's rasteriser, and what silhouettes are compared by. Letters: h w pixels, v vertices,
f faces, p fragments (a triangle at a pixel). Metres, OpenCV camera, pixel centres at +0.5.
"""

from __future__ import annotations

import numpy as np

from avatarrex.camera import Camera

NEAREST_DEPTH = 0.02
"""Metres: triangles that reach nearer to the camera are dropped."""
BATCH_FRAGMENTS = 2_000_000
"""Fragments of triangles' pixel boxes that are in memory at a time."""


def visible_faces(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First triangle under each pixel centre.

    Returns face (h, w) with −1 on the background, perspective-correct barycentrics (h, w, 3), camera z (h, w) in m.
    """
    height, width = camera.height, camera.width
    pixels, depth = camera.pixels(vertices, nearest=NEAREST_DEPTH)
    corners = pixels[faces]
    low = np.maximum(np.ceil(corners.min(1) - 0.5).astype(np.int64), 0)
    high = np.minimum(np.floor(corners.max(1) - 0.5).astype(np.int64), [width - 1, height - 1])
    kept = np.flatnonzero((depth[faces] > NEAREST_DEPTH).all(1) & (high >= low).all(1))
    area = (high - low + 1)[kept].prod(1)
    order = np.argsort(area, kind="stable")
    cuts = np.flatnonzero(np.diff(np.cumsum(area[order]) // BATCH_FRAGMENTS)) + 1
    best_z = np.full(height * width, np.inf)
    best_face = np.full(height * width, -1)
    best_bary = np.zeros((height * width, 3))
    for ids in np.split(kept[order], cuts):
        owner, pixel, screen = _fragments(corners[ids], low[ids], high[ids])
        target, owner = pixel[:, 1] * width + pixel[:, 0], ids[owner]
        weight = screen / depth[faces[owner]]
        z = 1 / weight.sum(1)
        first = np.lexsort((z, target))
        first = first[np.diff(target[first], prepend=-1) != 0]
        first = first[z[first] < best_z[target[first]]]
        best_z[target[first]] = z[first]
        best_face[target[first]] = owner[first]
        best_bary[target[first]] = weight[first] * z[first, None]
    shape = (height, width)
    return best_face.reshape(shape), best_bary.reshape(*shape, 3), best_z.reshape(shape)


def _fragments(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangle (p,), pixel x y (p, 2) and screen barycentrics (p, 3) of the pixel centres in triangles `corners` (f, 3, 2),
    which reach from pixel `low` (f, 2) to `high`.
    """
    extent = high - low + 1
    count = extent.prod(1)
    owner = np.repeat(np.arange(len(low)), count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    pixel = low[owner] + np.stack([offset % extent[owner, 0], offset // extent[owner, 0]], 1)
    a, b, c = (corners[owner, k] for k in range(3))
    p = pixel + 0.5
    area = _cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        screen = np.stack([_cross(c - b, p - b), _cross(a - c, p - c), _cross(b - a, p - a)], 1) / area[:, None]
    inside = (screen >= 0).all(1) & (area != 0)
    return owner[inside], pixel[inside], screen[inside]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
