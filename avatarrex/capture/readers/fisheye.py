"""Fisheye lenses by OpenCV's model, which is COLMAP's, too, and the pinhole that their pictures are undistorted to.

    r_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)

θ is a ray's angle from the axis, r_d how far from the principal point it is in the picture as taken, in focal lengths; the pinhole has it
at tan θ. Without coefficients the lens is equidistant. Radians.
"""

from __future__ import annotations

import numpy as np

COEFFICIENTS = 4
"""k1 to k4."""
WIDEST = np.radians(60)
"""Of a pinhole, from its axis to the middle of a side, at most: there a pixel is stretched fourfold outwards."""
STEEPEST = np.radians(70)
"""Rays farther from the axis are in no pinhole, whose corners are at 68° at most; there a detector's error is stretched eightfold."""
ON_AXIS = 1e-9
"""Focal lengths from the axis within which a point stays on it."""
INSET = 1 + 1e-5
"""By which pinholes show less than there is, so that rounding leaves no row of pixels beyond: a hundredth of a pixel in 1000."""
OUTSIDE = 1e3
"""Focal lengths beyond any picture: where points are that the lens cannot show."""


def distort(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Where the lens puts ideal points (…, 2) of the plane z = 1, in focal lengths; those it cannot show outside of any picture."""
    ideal = np.linalg.norm(points, axis=-1, keepdims=True)
    angle, limit = np.arctan(ideal), _limit(coefficients)
    taken = np.where(angle <= limit, _taken(np.minimum(angle, limit), coefficients), OUTSIDE)
    return np.asarray(points * (taken / np.maximum(ideal, ON_AXIS)))


def straighten(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The way back: points (…, 2) of the plane z = 1, NaN for what the lens or no pinhole can have shown."""
    taken = np.linalg.norm(points, axis=-1, keepdims=True)
    return np.asarray(points * (np.tan(_angle(taken, coefficients)) / np.maximum(taken, ON_AXIS)))


def pinhole(intrinsics: np.ndarray, coefficients: np.ndarray, size: tuple[int, int]) -> np.ndarray | None:
    """K (3, 3) of the pinhole of `size` (width, height) whose pictures a lens with K `intrinsics` fills.

    The principal point stays. The focal length is the shortest that leaves no side beyond the picture as taken, or farther than `WIDEST`
    from the axis: what is cut off lies beyond the farther sides. None for a lens that does not reach all sides of its pictures.
    """
    focal, middle = np.diag(intrinsics)[:2], intrinsics[:2, 2]
    sides = np.concatenate(
        [(middle - 0.5) / focal, (np.array(size) - 0.5 - middle) / focal]
    )  # centres of the outermost pixels
    limit = _limit(coefficients)
    if sides.min() <= 0 or (limit < WIDEST and sides.max() > _taken(limit, coefficients)):
        return None
    angles = np.fmin(_angle(sides, coefficients), WIDEST)
    found = intrinsics.copy()
    found[:2, :2] *= (sides / np.tan(angles)).max() * INSET
    return found


def _taken(angle: np.ndarray | float, coefficients: np.ndarray) -> np.ndarray:
    """r_d of θ."""
    return np.asarray(np.polyval([*coefficients[::-1], 1.0], np.square(angle)) * angle)


def _slope(angle: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """How r_d grows with θ."""
    odd = 2 * np.arange(COEFFICIENTS, 0, -1) + 1
    return np.asarray(np.polyval([*(odd * coefficients[::-1]), 1.0], np.square(angle)))


def _limit(coefficients: np.ndarray) -> float:
    """The angle up to which r_d grows with θ, so that each r_d is of one ray; `STEEPEST` at most."""
    angles = np.linspace(0, STEEPEST, 801)
    folds = np.flatnonzero(_slope(angles, coefficients) <= 0)
    return float(angles[folds[0] - 1] if len(folds) else STEEPEST)


def _angle(taken: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """θ of r_d, by Newton's steps from a table; NaN beyond the lens's limit."""
    limit = _limit(coefficients)
    table = np.linspace(0, limit, 257)
    angle = np.interp(taken, _taken(table, coefficients), table)
    for _ in range(4):
        step = (_taken(angle, coefficients) - taken) / _slope(angle, coefficients)
        angle = np.clip(angle - step, 0, limit)
    return np.where(taken <= _taken(limit, coefficients), angle, np.nan)
