"""Between the world and the screen: where points of the world are in the viewport, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from avatarrex_studio.session.state import OrbitView
from imgui_bundle import imgui
from jaxtyping import Float64

from avatarrex.camera import Camera

NEAR = 0.02
"""Metres before the camera from which points are on the screen."""
WORLD = np.eye(4)
"""The points are those of the view's world."""


@dataclass(frozen=True)
class Projection:
    """A camera whose raster fills a rectangle of the screen."""

    camera: Camera
    low: tuple[float, float]
    """Corner of the picture, points."""
    scale: float
    """Points a pixel."""

    @classmethod
    def of(cls, view: OrbitView, low: imgui.ImVec2, high: imgui.ImVec2, world: np.ndarray = WORLD) -> Projection:
        """Of a view in the rectangle from `low` to `high`; `world` (4, 4): from the frame of its points to the view's."""
        width, height = max(round(high.x - low.x), 1), max(round(high.y - low.y), 1)
        return cls(view.camera(width, height).seen_from(world), (low.x, low.y), (high.y - low.y) / height)

    def screen(self, points: Float64[np.ndarray, "... 3"]) -> Float64[np.ndarray, "... 2"]:
        """Where points of the world are, points of the screen; NaN behind the camera."""
        pixels, depth = self.camera.pixels(np.asarray(points, np.float64))
        return np.where(depth[..., None] > NEAR, self.low + self.scale * pixels, np.nan)

    def depth(self, point: Float64[np.ndarray, "3"]) -> float:
        """Camera z of a point of the world, metres."""
        return float(self.camera.seen(point)[2])

    def world(self, place: tuple[float, float], depth: float) -> Float64[np.ndarray, "3"]:
        """The point of the world at a place of the screen, `depth` metres from the camera's plane."""
        x, y = (np.array(place) - self.low) / self.scale
        return self.camera.point((x, y), depth)
