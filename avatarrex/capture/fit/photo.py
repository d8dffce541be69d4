"""A picture as poses are compared with it: blurred, and which points of a posed template it shows.

Letters: p points, h w pixels. World metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import reduced
from avatarrex.capture.zbuffer import NEAREST_DEPTH, visible_faces

PHOTO_PIXELS = 512
"""Pixels of the longer side at most."""
FACING = 0.3
"""Cosine from which a point is believed: beyond 72 degrees a pixel covers three times its width."""
OPAQUE = 250
"""Matte byte from which a pixel has the person's colour alone."""
LEAST_BLUR = 0.7
"""Pixels: a slope between neighbours means something from here on."""


@dataclass(frozen=True, eq=False)
class Photo:
    """One picture."""

    camera: Camera
    image: Callable[[], np.ndarray]
    """Reads (h, w, 3), sRGB bytes."""
    matte: Callable[[], np.ndarray]
    """Reads (h, w), bytes."""

    def small(self) -> tuple[Camera, np.ndarray, np.ndarray]:
        """Camera, image (h, w, 3) and matte (h, w), bytes, of `PHOTO_PIXELS` at most. What reading a picture raises is raised."""
        camera = reduced(self.camera, PHOTO_PIXELS)
        image, matte = (
            np.asarray(Image.fromarray(layer).resize((camera.width, camera.height), Image.Resampling.BOX))
            for layer in (self.image(), self.matte())
        )
        return camera, image, matte

    def blurred(self, depth: float, blur: float) -> Blurred:
        """With a Gaussian whose σ is `blur` metres, `depth` metres away. What reading a picture raises is raised."""
        camera, image, matte = self.small()
        sigma = max(blur * camera.intrinsics[0, 0] / depth, LEAST_BLUR)
        solid = (matte >= OPAQUE).astype(np.float32)
        whole = gaussian_filter(solid, sigma) + 1e-3
        layers = []
        for channel in range(3):
            colour = gaussian_filter(image[..., channel] / np.float32(255) * solid, sigma) / whole
            down, right = np.gradient(colour)
            layers += [colour, right, down]
        return Blurred(camera, np.stack(layers), solid > 0)


@dataclass(frozen=True, eq=False)
class Blurred:
    """Colours and their slopes."""

    camera: Camera
    layers: np.ndarray
    """(9, h, w): of each channel the colour, its slope to the right and downwards by pixel."""
    solid: np.ndarray
    """(h, w) bool: where the person alone is."""

    def at(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours (p, 3) where points `place` (p, 3) are seen, and how they change (p, 3, 3) by channel as the points move."""
        pixel = self.camera.pixels(place)[0]
        where = pixel[:, ::-1].T - 0.5
        found = np.stack([map_coordinates(layer, where, order=1, mode="nearest") for layer in self.layers], 1)
        found = found.reshape(len(place), 3, 3)
        return found[..., 0], found[..., 1:] @ self.camera.slopes(place)

    def shows(
        self, vertices: np.ndarray, faces: np.ndarray, face: np.ndarray, place: np.ndarray, tolerance: float
    ) -> np.ndarray:
        """(p,) cosine at which points `place` (p, 3) of triangles `face` (p,) are seen; 0 where something `tolerance` metres before
        them hides them."""
        camera = self.camera
        a, b, c = (vertices[faces[face, corner]] for corner in range(3))
        normal, way = np.cross(b - a, c - a), camera.centre - place
        length = np.linalg.norm(normal, axis=1) * np.linalg.norm(way, axis=1)
        cosine: np.ndarray = (normal * way).sum(1) / np.maximum(length, 1e-20)
        pixel, depth = camera.pixels(place, nearest=NEAREST_DEPTH)
        inside = (cosine > FACING) & (depth > NEAREST_DEPTH) & (pixel >= 0).all(1)
        seen = np.flatnonzero(inside & (pixel < (camera.width, camera.height)).all(1))
        column, row = pixel[seen].astype(np.int64).T
        first = visible_faces(vertices, faces, camera)[2][row, column]
        seen = seen[(depth[seen] < first + tolerance) & self.solid[row, column]]
        found = np.zeros(len(place))
        found[seen] = cosine[seen]
        return found
