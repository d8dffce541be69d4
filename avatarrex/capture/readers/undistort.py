"""Images of an ideal pinhole from those of a real lens: OpenCV's five coefficients, or a fisheye (fisheye.py), bilinear.

x_d = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²), y_d alike; x, y on the plane z = 1. Letters: h w pixels.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from avatarrex.capture.readers import fisheye
from avatarrex.capture.readers.calibration import Lens

STRAIGHTENED = 20
"""Fixed-point steps back through a lens: each leaves the share of its error that the lens bends a point by, a fifth at most."""


def distort(points: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """Where the lens puts ideal points (…, 2) of the plane z = 1."""
    k1, k2, p1, p2, k3 = distortion
    x, y = points[..., 0], points[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        -1,
    )


def bend(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Where points (…, 2) of the ideal picture are in the taken one, pixels with centres at +0.5."""
    plane = _on_plane(pixels, lens.camera.intrinsics)
    bent = distort(plane, lens.distortion) if lens.fisheye is None else fisheye.distort(plane, lens.distortion)
    return _in_picture(bent, lens.taken)


def straighten(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Where points (…, 2) of the taken picture are in the ideal one, pixels with centres at +0.5.

    One far from the picture that this lens cannot have shown ends anywhere, or is NaN.
    """
    if not lens.distorts:
        return pixels
    bent = _on_plane(pixels, lens.taken)
    if lens.fisheye is not None:
        return _in_picture(fisheye.straighten(bent, lens.distortion), lens.camera.intrinsics)
    plane = bent
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(STRAIGHTENED):
            plane = plane + bent - distort(plane, lens.distortion)
    return _in_picture(plane, lens.camera.intrinsics)


def _on_plane(pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Pixels (…, 2) on the plane z = 1."""
    return np.asarray((pixels - intrinsics[:2, 2]) @ np.linalg.inv(intrinsics[:2, :2]).T)


def _in_picture(plane: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """The way back."""
    return np.asarray(plane @ intrinsics[:2, :2].T + intrinsics[:2, 2])


def source_pixels(lens: Lens) -> np.ndarray:
    """For every pixel (h, w) of the ideal image, (2, h, w) float32 row and column in the taken one (centres at integers)."""
    camera = lens.camera
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixel = bend(lens, np.stack([column, row], -1))
    return np.asarray(np.moveaxis(pixel[..., ::-1] - 0.5, -1, 0), np.float32)


def undistort(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """`image` (h, w) or (h, w, 3) uint8 at `pixels` of `source_pixels`; black (no matte) beyond its edge."""
    planes = image[..., None] if image.ndim == 2 else image
    taken = np.empty_like(planes)
    for channel in range(planes.shape[2]):
        values = map_coordinates(
            planes[..., channel], pixels, output=np.float32, order=1, mode="constant", cval=0.0, prefilter=False
        )
        taken[..., channel] = np.rint(np.clip(values, 0, 255))
    return taken[..., 0] if image.ndim == 2 else taken
