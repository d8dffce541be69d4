"""How a template's silhouette lies against a matte: what share they have in common, how far it is off, how much it leans.

By moments of the pixels inside: the centroid, and the principal axis of their covariance. Letters: h w pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ELONGATED = 1.5
"""Ratio of the standard deviations along the principal axes from which there is a direction to lean from."""


@dataclass(frozen=True)
class Alignment:
    """Of one silhouette against one matte."""

    shift: tuple[float, float]
    """From the matte's centroid to the silhouette's, right and down, in units of the square root of the matte's area."""
    lean_deg: float | None
    """From the matte's axis to the silhouette's, clockwise in the picture; None where either is not elongated, or cut off at an edge."""


def alignment(silhouette: np.ndarray, inside: np.ndarray) -> Alignment | None:
    """Of masks (h, w); None where either is empty."""
    if not (silhouette.any() and inside.any()):
        return None
    own, matte = _moments(silhouette), _moments(inside)
    off = (own[0] - matte[0]) / np.sqrt(inside.sum())
    lean = None
    if min(own[2], matte[2]) > ELONGATED and not (_cut_off(silhouette) or _cut_off(inside)):
        lean = float((np.degrees(own[1] - matte[1]) + 90) % 180 - 90)
    return Alignment((float(off[0]), float(off[1])), lean)


def _cut_off(mask: np.ndarray) -> bool:
    """Whether it reaches the picture's edge."""
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())


def _moments(mask: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Centroid (column, row), angle of the longer axis from the columns' direction (radians), ratio of the axes."""
    points = np.argwhere(mask)[:, ::-1].astype(np.float64)
    values, axes = np.linalg.eigh(np.cov(points.T, bias=True) + 1e-9 * np.eye(2))
    return points.mean(0), float(np.arctan2(axes[1, 1], axes[0, 1])), float(np.sqrt(values[1] / values[0]))
