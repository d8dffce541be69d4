"""The rays of a view as seen from the volume: they start on a plane through it, not at the camera.

With everything taken in float64 here and only differences of metre size handed on, float32 rays are as exact a
kilometre from the camera as at arm's length. Letters: r rays. Root frame, metres; pixels with centres at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.volume.sdf_volume import PartBox

NEAREST_PLANE = 0.5
"""Metres: the plane's least depth, for cameras inside or behind the volume."""
SUBPIXELS = (np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(16, 2) + 0.5) / 4
"""(16, 2) positions within a pixel, x fastest."""


@dataclass(frozen=True)
class RayPlane:
    """The ray through pixel (x, y) starts at `point + (x − mx) across + (y − my) down`; all float64."""

    middle: Float[np.ndarray, "2"]
    """(mx, my), the pixel position that sees `point`."""
    point: Float[np.ndarray, "3"]
    gaze: Float[np.ndarray, "3"]
    """`point` minus the camera centre."""
    across: Float[np.ndarray, "3"]
    down: Float[np.ndarray, "3"]
    """Metres per pixel on the plane."""

    @staticmethod
    def of(camera: Camera, centre: Float[np.ndarray, "3"]) -> RayPlane:
        """The plane parallel to the image through `centre`, the volume's middle."""
        root_from_camera = camera.camera_from_world[:3, :3].T
        depth = max(float(camera.camera_from_world[2] @ np.append(centre, 1.0)), NEAREST_PLANE)
        middle = np.array([camera.width / 2, camera.height / 2])
        inverse = np.linalg.inv(camera.intrinsics)
        gaze, across, down = (
            depth * root_from_camera @ inverse @ np.array(pixel) for pixel in ([*middle, 1.0], [1, 0, 0], [0, 1, 0])
        )
        return RayPlane(middle, camera.centre + gaze, gaze, across, down)

    def rays(self, pixel: Float[Tensor, "r 2"]) -> Rays:
        """Rays through pixel positions, in the positions' dtype."""
        step = pixel - torch.as_tensor(self.middle).to(pixel)
        offset = step @ torch.as_tensor(np.stack([self.across, self.down])).to(pixel)
        gaze = torch.as_tensor(self.gaze).to(pixel) + offset
        length = gaze.norm(dim=-1)
        origin = torch.as_tensor(self.point).to(pixel) + offset
        return Rays(origin, gaze / length[:, None], -length)

    @property
    def footprint(self) -> float:
        """Half a pixel's diagonal on the plane, metres."""
        return 0.5 * float(np.linalg.norm(self.across) + np.linalg.norm(self.down))


@dataclass(frozen=True)
class Rays:
    """Half lines; t in metres from `origin`."""

    origin: Float[Tensor, "r 3"]
    direction: Float[Tensor, "r 3"]
    camera: Float[Tensor, " r"]
    """t of the camera centre, negative: nothing before it is seen."""

    def at(self, t: Float[Tensor, " r"]) -> Float[Tensor, "r 3"]:
        """Points at t."""
        return self.origin + t[:, None] * self.direction

    def __getitem__(self, rows: Tensor | slice) -> Rays:
        return Rays(self.origin[rows], self.direction[rows], self.camera[rows])


def slab(
    origin: Float[Tensor, "r 3"], direction: Float[Tensor, "r 3"], size: Float[Tensor, "3"]
) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
    """Entry and exit t of the box [0, size]; entry > exit where a ray misses. Safe for rays parallel to a face."""
    safe = torch.where(direction.abs() < 1e-12, 1e-12, direction)
    one, two = -origin / safe, (size - origin) / safe
    return torch.minimum(one, two).amax(-1), torch.maximum(one, two).amin(-1)


def box_window(box: PartBox, camera: Camera) -> Float[np.ndarray, "4"]:
    """(x, y) from and to, in pixels, between which a box is seen; everything where it reaches behind the camera."""
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3) * box.size
    pixel, depth = camera.seen_from(np.linalg.inv(box.box_from_root)).pixels(corners)
    if depth.min() < 1e-3:
        return np.array([-np.inf, -np.inf, np.inf, np.inf])
    return np.concatenate([pixel.min(0) - 1, pixel.max(0) + 1])


def pixel_centres(camera: Camera, dtype: torch.dtype = torch.float32) -> Float[Tensor, "r 2"]:
    """(x, y) of all pixels, row by row."""
    y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    return torch.stack([x, y], -1).view(-1, 2).to(dtype) + 0.5
