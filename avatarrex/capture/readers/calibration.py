"""Calibrated cameras of a rig, from AvatarReX's and THuman4.0's JSON.

{camera: {K 9, R 9, T 3, distCoeff 4 or 5, imgSize [w, h]}}, matrices flat or nested; world→camera, OpenCV axes. `fisheye: true` says that
the four coefficients are those of OpenCV's fisheyes. `gain: [r, g, b]` is ours: what its sRGB pictures are multiplied by, so that
all cameras of a rig have one exposure and white balance (fit/camera_gains.py).
Pixel centres are taken at i + 0.5, as everywhere in this project.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.readers.archive import LONGEST_NAME, safe
from avatarrex.capture.readers.fisheye import COEFFICIENTS, pinhole
from avatarrex.errors import InputError, check
from avatarrex.files.json_text import parse_json

MOST_CAMERAS = 1000
"""Of a rig; the largest stages have a few hundred."""
ROTATION_SLACK = 1e-2
"""Largest entry of RᵀR − I: files round R to as few as three digits; it is then replaced by the nearest rotation."""
LARGEST_NUMBER = 1e9
"""Largest number: 1000 km in millimetres; a focal length in pixels is far below."""
LARGEST_GAIN = 8.0
"""Factor at most, either way."""
SMALL_DISTORTION = 1e-4
"""Σ|k| below which a lens is taken as ideal: at most 0.15 pixels in the corner of a 1500×2048 image."""


@dataclass(frozen=True, eq=False)
class Lens:
    """One camera as calibrated."""

    name: str
    camera: Camera
    """The ideal pinhole that images are undistorted to."""
    distortion: np.ndarray
    """k1, k2, p1, p2, k3 of OpenCV, (5,); k1 to k4 of a fisheye, (4,)."""
    fisheye: np.ndarray | None = None
    """K (3, 3) of a fisheye's images as taken, whose pinhole has another focal length; None of other lenses."""
    gain: tuple[float, ...] = (1.0, 1.0, 1.0)
    """What red, green and blue of the sRGB images are multiplied by."""

    @property
    def taken(self) -> np.ndarray:
        """K (3, 3) of the images as taken."""
        return self.camera.intrinsics if self.fisheye is None else self.fisheye

    @property
    def distorts(self) -> bool:
        """Whether images have to be undistorted."""
        return self.fisheye is not None or float(np.abs(self.distortion).sum()) >= SMALL_DISTORTION

    def scaled(self, scale: float) -> Lens:
        """The same camera with its position multiplied by `scale`."""
        matrix = self.camera.camera_from_world.copy()
        matrix[:3, 3] *= scale
        return replace(self, camera=replace(self.camera, camera_from_world=matrix))


def fisheye_lens(name: str, taken: Camera, coefficients: np.ndarray, source: object, field: str) -> Lens:
    """Of a fisheye whose images as taken have the K of `taken`. Raises `InputError` naming `field`, that of k1 to k4 (4,)."""
    check(
        len(coefficients) == COEFFICIENTS,
        source,
        field,
        "4 coefficients k1, k2, k3, k4 of a fisheye",
        len(coefficients),
    )
    ideal = pinhole(taken.intrinsics, coefficients, (taken.width, taken.height))
    if ideal is None:
        expected = "a fisheye that shows rays up to each side of its pictures, about a principal point within"
        raise InputError(source, field, expected, coefficients.tolist())
    return Lens(name, replace(taken, intrinsics=ideal), coefficients, taken.intrinsics)


def read_calibration(text: str, source: str) -> tuple[Lens, ...]:
    """Cameras in the file's order. Raises `InputError` naming camera and key."""
    cameras = parse_json(text, source)
    if not isinstance(cameras, dict) or not cameras:
        raise InputError(source, "", "an object with one entry per camera", type(cameras).__name__)
    if len(cameras) > MOST_CAMERAS:
        raise InputError(source, "", f"at most {MOST_CAMERAS} cameras", len(cameras))
    return tuple(_lens(name, entry, source) for name, entry in cameras.items())


def _lens(name: str, entry: Any, source: str) -> Lens:
    if not safe(name) or "/" in name or not name.isprintable() or len(name) > LONGEST_NAME:
        raise InputError(source, repr(name), "a camera's name that can name a folder", "another form")
    if not isinstance(entry, dict):
        raise InputError(source, name, "an object with K, R, T, imgSize", type(entry).__name__)
    intrinsics = _numbers(entry, "K", (9,), name, source).reshape(3, 3)
    if not (intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0 and np.allclose(intrinsics[2], [0, 0, 1])):
        raise InputError(source, f"{name}.K", "focal lengths above 0 and a last row of 0, 0, 1", intrinsics.tolist())
    width, height = _numbers(entry, "imgSize", (2,), name, source)
    if not all(side == int(side) and 1 <= side <= 16384 for side in (width, height)):
        raise InputError(source, f"{name}.imgSize", "[width, height], integers from 1 to 16384", [width, height])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = nearest_rotation(
        _numbers(entry, "R", (9,), name, source).reshape(3, 3), source, f"{name}.R"
    )
    camera_from_world[:3, 3] = _numbers(entry, "T", (3,), name, source)
    camera = Camera(intrinsics, camera_from_world, int(width), int(height))
    fisheye = entry.get("fisheye", False)
    check(isinstance(fisheye, bool), source, f"{name}.fisheye", "true or false", repr(fisheye)[:60])
    if fisheye:
        coefficients = _numbers(entry, "distCoeff", (None,), name, source)
        lens = fisheye_lens(name, camera, coefficients, source, f"{name}.distCoeff")
    else:
        lens = Lens(name, camera, _distortion(entry, name, source))
    return replace(lens, gain=_gain(entry, name, source))


def nearest_rotation(matrix: np.ndarray, source: object, field: str) -> np.ndarray:
    """(3, 3): the rotation nearest to `matrix`. Raises `InputError` where that is none, or mirrors."""
    off = np.abs(matrix.T @ matrix - np.eye(3)).max()
    if off > ROTATION_SLACK or np.linalg.det(matrix) < 0:
        found = "a mirroring" if off <= ROTATION_SLACK else f"columns off orthonormal by {off:.2g}"
        raise InputError(source, field, "a rotation, world to camera", found)
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def _distortion(entry: dict[str, Any], name: str, source: str) -> np.ndarray:
    """(5,); none given means none, and beyond five only zeros are understood."""
    if entry.get("distCoeff") in (None, []):
        return np.zeros(5)
    values = _numbers(entry, "distCoeff", (None,), name, source)
    if len(values) < 4 or values[5:].any():
        raise InputError(source, f"{name}.distCoeff", "4 or 5 coefficients k1, k2, p1, p2, k3", len(values))
    return np.pad(values[:5], (0, max(5 - len(values), 0)))


def _gain(entry: dict[str, Any], name: str, source: str) -> tuple[float, ...]:
    """One of each channel; 1 unless given."""
    if "gain" not in entry:
        return (1.0, 1.0, 1.0)
    return checked_gain(_numbers(entry, "gain", (3,), name, source), source, f"{name}.gain")


def checked_gain(gain: np.ndarray, source: object, field: str) -> tuple[float, ...]:
    """A camera's (3,). Raises `InputError` naming `field`."""
    within = (gain >= 1 / LARGEST_GAIN) & (gain <= LARGEST_GAIN)
    expected = f"[r, g, b], factors from {1 / LARGEST_GAIN:g} to {LARGEST_GAIN:g}"
    check(bool(within.all()), source, field, expected, gain.tolist())
    return tuple(gain.tolist())


def _numbers(entry: dict[str, Any], key: str, shape: tuple[int | None], name: str, source: str) -> np.ndarray:
    """Finite numbers, however they are nested."""
    if key not in entry:
        raise InputError(source, f"{name}.{key}", "the key to be there", f"only {', '.join(sorted(entry)[:8])}")
    try:
        values = np.array(entry[key], dtype=np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        raise InputError(source, f"{name}.{key}", "numbers", repr(entry[key])[:60]) from None
    if shape[0] not in (None, len(values)):
        raise InputError(source, f"{name}.{key}", f"{shape[0]} numbers", len(values))
    if not np.isfinite(values).all():
        raise InputError(source, f"{name}.{key}", "finite numbers", "NaN or Inf")
    if np.abs(values).max(initial=0) > LARGEST_NUMBER:
        raise InputError(source, f"{name}.{key}", f"numbers up to {LARGEST_NUMBER:g}", f"{np.abs(values).max():g}")
    return values
