"""Preview pictures of a posed subject: a small z-buffer on the CPU, supersampled, no GL.

A modest look at the ground truth while it is made; the capture has its own rasteriser. Letters: h w pixels, f faces.
Root frame, metres, OpenCV camera, pixel centres at +0.5; colours sRGB-encoded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from avatarrex.camera import Camera

if TYPE_CHECKING:
    from avatarrex.capture.synthetic.subject import PosedSubject

NEAR = 0.02
"""Metres: triangles that reach nearer to the camera are dropped."""


def visible_faces(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First triangle under each pixel centre.

    Returns face (h, w) with −1 on the background, perspective-correct barycentrics (h, w, 3), camera z (h, w) in m.
    """
    height, width = camera.height, camera.width
    seen = vertices @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    depth = seen[:, 2]
    pixel = (seen @ camera.intrinsics.T)[:, :2] / np.maximum(depth, NEAR)[:, None]
    corners = pixel[faces]
    low = np.ceil(corners.min(1) - 0.5).astype(np.int64)
    high = np.floor(corners.max(1) - 0.5).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, [width - 1, height - 1])
    keep = (depth[faces] > NEAR).all(1) & (high >= low).all(1)
    best_z = np.full(height * width, np.inf)
    best_face = np.full(height * width, -1)
    best_bary = np.zeros((height * width, 3))
    ids = np.flatnonzero(keep)
    extent = (high - low + 1)[ids]
    order = np.argsort(extent.prod(1), kind="stable")
    for part in _batches(extent.prod(1)[order]):
        _draw(ids[order[part]], faces, corners, depth, low, high, width, best_z, best_face, best_bary)
    shape = (height, width)
    return best_face.reshape(shape), best_bary.reshape(*shape, 3), best_z.reshape(shape)


def preview(posed: PosedSubject, camera: Camera, supersampling: int = 2, background: float = 0.93) -> np.ndarray:
    """Picture (h, w, 3) uint8 of `posed` from a camera whose world is the root frame."""
    s = supersampling
    face, bary, _ = visible_faces(
        posed.vertices, posed.subject.faces, camera.resized(camera.width * s, camera.height * s)
    )
    image = np.full((*face.shape, 3), background)
    hit = face >= 0
    image[hit] = posed.colour_at(face[hit], bary[hit])
    image = image.reshape(camera.height, s, camera.width, s, 3).mean((1, 3))
    return np.round(image * 255).astype(np.uint8)


def _batches(areas: np.ndarray, budget: int = 2_000_000) -> list[slice]:
    """Consecutive slices of triangles whose padded pixel boxes fit in memory; `areas` ascending."""
    slices, start = [], 0
    while start < len(areas):
        stop = start + 1
        size = max(int(areas[start]) * 2, 16)
        stop = min(int(np.searchsorted(areas, size, side="right")), start + max(budget // size, 1))
        slices.append(slice(start, stop := max(stop, start + 1)))
        start = stop
    return slices


def _draw(
    ids: np.ndarray,
    faces: np.ndarray,
    corners: np.ndarray,
    depth: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    width: int,
    best_z: np.ndarray,
    best_face: np.ndarray,
    best_bary: np.ndarray,
) -> None:
    """Z-test all pixels in the boxes of triangles `ids`; the buffers are updated in place."""
    extent = high[ids] - low[ids] + 1
    count = extent.prod(1)
    owner = np.repeat(np.arange(len(ids)), count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    x = low[ids][owner, 0] + offset % extent[owner, 0]
    y = low[ids][owner, 1] + offset // extent[owner, 0]
    a, b, c = (corners[ids][owner, k] for k in range(3))
    p = np.stack([x, y], 1) + 0.5
    area = _cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        screen = np.stack([_cross(c - b, p - b), _cross(a - c, p - c), _cross(b - a, p - a)], 1) / area[:, None]
    inside = (screen >= 0).all(1) & (area != 0)
    owner, screen, target = owner[inside], screen[inside], (y * width + x)[inside]
    weight = screen / depth[faces[ids[owner]]]
    z = 1 / weight.sum(1)
    first = np.lexsort((z, target))
    first = first[np.r_[True, np.diff(target[first]) != 0]] if len(first) else first
    first = first[z[first] < best_z[target[first]]]
    best_z[target[first]] = z[first]
    best_face[target[first]] = ids[owner[first]]
    best_bary[target[first]] = weight[first] * z[first, None]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
