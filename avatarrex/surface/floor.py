"""The light that a floor gets under a figure: a map of the key light and of the sky, and where on the floor it lies.

    key, sky ∈ [0, 1]: the share of each that reaches a point        brightness = KEY · key + SKY · sky

A map is a square of texels over a rectangle of the floor, rows along z, texel centres at +0.5. World frame, metres.
Letters: z x texels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

KEY, SKY = 0.6, 0.4
"""Shares of the two lights."""
FIGURE = 0.4
"""How much of a shadow falls on the figure itself: its colours contain the light that it was captured in."""
MARGIN = 0.5
"""Metres of floor around a figure that its presence darkens."""
FADE = 0.2
"""Metres at the border of a map over which its shadow ends."""
Region = tuple[float, float, float, float]
"""Least x and z, greatest x and z."""


@dataclass(frozen=True, eq=False)
class FloorLight:
    """Key light and sky on a part of a floor; outside it both are whole."""

    region: Region
    values: UInt8[np.ndarray, "z x 2"]


def floor_region(corners: Float[np.ndarray, "p 3"], direction: Float[np.ndarray, "3"], height: float) -> Region:
    """Where a floor is darkened by what lies in boxes with these world corners, by a light from `direction` (unit)."""
    above = np.maximum(corners[:, 1] - height, 0)[:, None]
    ground = corners[:, [0, 2]]
    touched = np.concatenate([ground, ground - above * direction[[0, 2]] / direction[1]])
    low, high = touched.min(0) - MARGIN, touched.max(0) + MARGIN
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def span(region: Region) -> float:
    """The longer side of a rectangle of the floor."""
    return max(region[2] - region[0], region[3] - region[1])


def box_corners(
    bounds: Float[np.ndarray, "2 3"], world_from_root: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "8 3"]:
    """World corners of a box of the root frame."""
    corner = np.stack(np.meshgrid(*np.asarray(bounds, np.float64).T), -1).reshape(8, 3)
    return np.asarray(corner @ world_from_root[:3, :3].T + world_from_root[:3, 3])


def texel_centres(region: Region, height: float, side: int) -> Float[np.ndarray, "p 3"]:
    """World points of a map's texels, row by row."""
    step = (np.arange(side) + 0.5) / side
    x = region[0] + (region[2] - region[0]) * step
    z = region[1] + (region[3] - region[1]) * step
    grid = np.meshgrid(z, x, indexing="ij")
    return np.stack([grid[1], np.full((side, side), height), grid[0]], -1).reshape(-1, 3)


def brightness(values: Float[np.ndarray, "*p 2"]) -> Float[np.ndarray, "*p"]:
    """Of key light and sky together."""
    return np.asarray(values @ np.array([KEY, SKY], values.dtype))
