"""Between the world and the screen: where points of the world are in the viewport, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from avatarrex_studio.session.state import OrbitView
from imgui_bundle import imgui
from jaxtyping import Float64

from avatarrex.camera import Camera

NEAR, FAR = 0.02, 100.0
"""Metres: clip planes of a gizmo."""


@dataclass(frozen=True)
class Projection:
    """A camera whose raster fills a rectangle of the screen."""

    camera: Camera
    low: tuple[float, float]
    """Corner of the picture, points."""
    scale: float
    """Points a pixel."""

    @classmethod
    def of(cls, view: OrbitView, low: imgui.ImVec2, high: imgui.ImVec2) -> Projection:
        """Of a view in the rectangle from `low` to `high`."""
        width, height = max(round(high.x - low.x), 1), max(round(high.y - low.y), 1)
        return cls(view.camera(width, height), (low.x, low.y), (high.y - low.y) / height)

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

    @property
    def view_matrix(self) -> Float64[np.ndarray, "4 4"]:
        """OpenGL's view: y up, the camera looks along −z."""
        return np.asarray(np.diag([1.0, -1.0, -1.0, 1.0]) @ self.camera.camera_from_world)

    @property
    def clip_matrix(self) -> Float64[np.ndarray, "4 4"]:
        """OpenGL's projection of the same."""
        k, camera = self.camera.intrinsics, self.camera
        clip = np.zeros((4, 4))
        clip[0, 0], clip[1, 1] = 2 * k[0, 0] / camera.width, 2 * k[1, 1] / camera.height
        clip[2, 2:], clip[3, 2] = ((FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)), -1.0
        return clip
