"""Where in a picture a posed surface may be seen, and how its pieces are projected.

Letters: v vertices. Root frame, metres, OpenCV camera; pixels, image row 0 at the top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from avatarrex.camera import Camera

NEAR_PLANE = 0.02
"""Metres: what is nearer to the camera is not seen."""
MARGIN = 1e-3
"""By which the depth range is wider than the box, of its depth: a triangle may touch the box."""
Box = tuple[int, int, int, int]
"""Left, top, width, height in pixels."""


@dataclass(frozen=True)
class Extent:
    """All that a picture may show of a surface."""

    box: Box
    near: float
    far: float

    @classmethod
    def of(cls, bounds: Float[np.ndarray, "2 3"], camera: Camera) -> Extent | None:
        """Of what lies between two corners, root frame, from a camera whose world it is; None: nothing of it is seen."""
        corner = np.stack(np.meshgrid(*bounds.astype(np.float64).T), -1).reshape(8, 3)
        seen = corner @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
        nearest, farthest = seen[:, 2].min(), seen[:, 2].max()
        if farthest <= NEAR_PLANE:
            return None
        size = np.array([camera.width, camera.height])
        first, last = np.zeros(2, int), size
        if nearest > NEAR_PLANE:
            pixel = (seen @ camera.intrinsics.T)[:, :2] / seen[:, 2:]
            first, last = (np.clip(at, 0, size).astype(int) for at in (np.floor(pixel.min(0)), np.ceil(pixel.max(0))))
        if (last <= first).any():
            return None
        width, height = (last - first).tolist()
        near = max(NEAR_PLANE, float(nearest - MARGIN * abs(nearest)))
        return cls((int(first[0]), int(first[1]), width, height), near, float(farthest * (1 + MARGIN)))

    @classmethod
    def around(cls, extents: Sequence[Extent]) -> Extent | None:
        """What contains several; None: there is none."""
        if not extents:
            return None
        boxes = np.array([one.box for one in extents])
        first, last = boxes[:, :2].min(0), (boxes[:, :2] + boxes[:, 2:]).max(0)
        box = (int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1]))
        return cls(box, min(one.near for one in extents), max(one.far for one in extents))

    def tiles(self, side: int) -> list[Box]:
        """The box in pieces of at most `side` pixels a side."""
        left, top, width, height = self.box
        return [
            (x, y, min(side, left + width - x), min(side, top + height - y))
            for y in range(top, top + height, side)
            for x in range(left, left + width, side)
        ]

    def clip_from_root(self, camera: Camera, tile: Box) -> Float[np.ndarray, "4 4"]:
        """The tile fills [−1, 1]², its top row first; w is the camera's z."""
        left, top, width, height = tile
        k, near, far = camera.intrinsics, self.near, self.far
        project = np.array([
            [2 * k[0, 0] / width, 2 * k[0, 1] / width, 2 * (k[0, 2] - left) / width - 1, 0],
            [0, 2 * k[1, 1] / height, 2 * (k[1, 2] - top) / height - 1, 0],
            [0, 0, (far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, 1, 0],
        ])  # fmt: skip
        return np.asarray(project @ camera.camera_from_world)
