"""Compiled loops of silhouettes and outlines against NumPy's and SciPy's operations."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import FOREGROUND
from avatarrex.capture.fit.outlines import SEARCH_STEP, to_edge
from avatarrex.capture.zbuffer import visible_faces


def edges(matte: np.ndarray, pixel: np.ndarray, along: np.ndarray, scale: np.ndarray, search: float) -> np.ndarray:
    """All places along the normals at once."""
    count = round(search / SEARCH_STEP)
    steps = np.linspace(-search, search, 2 * count + 1)
    places = pixel[:, None] + along[:, None] * (steps[None, :, None] * scale[:, None, None])
    value = map_coordinates(matte.astype(np.float32), np.moveaxis(places[..., ::-1], -1, 0) - 0.5, order=1) - FOREGROUND
    leaves = (value[:, :-1] > 0) & (value[:, 1:] <= 0)
    best, row = np.where(leaves, np.abs(steps[:-1] + steps[1:]), np.inf).argmin(1), np.arange(len(pixel))
    high, low = value[row, best], value[row, best + 1]
    return np.where(leaves.any(1), steps[best] + SEARCH_STEP * high / np.maximum(high - low, 1e-6), np.nan)


def test_the_nearest_edge_along_a_normal(rng: np.random.Generator) -> None:
    """Inside, beyond the picture, and nowhere."""
    matte = (255 * (gaussian_filter(rng.standard_normal((90, 70)), 6) > 0)).astype(np.uint8)
    pixel, along, scale = rng.uniform(-8, 98, (800, 2)), rng.standard_normal((800, 2)), rng.uniform(50, 300, 800)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    found, expected = to_edge(matte, pixel, along, scale, 0.06), edges(matte, pixel, along, scale, 0.06)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert 0.1 < np.isnan(found).mean() < 0.9


def test_the_first_triangle_under_each_pixel(rng: np.random.Generator) -> None:
    """Triangle by triangle; one has no area, one lies behind the camera."""
    vertices, faces = rng.uniform(-0.6, 0.6, (60, 3)), rng.integers(0, 60, (80, 3))
    vertices[0], faces[0], faces[1] = (0, 0, 5), (0, 1, 2), (3, 3, 4)
    camera = Camera.orbit(20, 10, 2.0, 45, (0, 0, 0), 50, 40)
    face, bary, z = visible_faces(vertices, faces, camera)
    pixels, depth = camera.pixels(vertices)
    centres = np.stack(np.meshgrid(np.arange(50) + 0.5, np.arange(40) + 0.5), -1)
    nearest, which = np.full((40, 50), np.inf), np.full((40, 50), -1)
    for f, ids in enumerate(faces):
        corner = np.concatenate([pixels[ids], np.ones((3, 1))], 1).T
        if abs(np.linalg.det(corner)) < 1e-9 or depth[ids].min() < 0:
            continue
        share = np.concatenate([centres, np.ones((40, 50, 1))], -1) @ np.linalg.inv(corner).T
        away = np.where((share >= 0).all(-1), 1 / (share / depth[ids]).sum(-1), np.inf)
        closer = away < nearest
        nearest[closer], which[closer] = away[closer], f
    np.testing.assert_array_equal(face, which)
    np.testing.assert_allclose(z, nearest)
    seen = face >= 0
    assert 0.3 < seen.mean() < 1
    points = np.einsum("pk,pkc->pc", bary[seen], vertices[faces[face[seen]]])
    np.testing.assert_allclose(camera.pixels(points)[0], centres[seen], atol=1e-9)
