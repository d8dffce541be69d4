"""A plane through the volumes of exact frames: the signed distances that they store there, as colour and iso-lines.

Outside blue, inside orange, white where it is zero, dark lines at each centimetre (each 5 cm from far). Where no voxel was evaluated,
for far from the skin a volume stores bounds alone, the inside is of one dark colour, and outside there is nothing. Of several figures
the nearest counts.

Letters: h w pixels, p points of the plane. World, metres, negative inside; premultiplied sRGB-encoded.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from avatarrex_studio.session.cut import Cut
from jaxtyping import Bool, Float, Float32

from avatarrex.camera import Camera
from avatarrex.frame import DeferredFrame
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume, distance

REACH, STRONG = 0.08, 0.92
"""Metres outside the surface at which the colour has faded out, and its opacity inside."""
STEPS = (0.01, 0.05)
"""Metres between iso-lines: the first whose lines are at least `APART` pixels apart."""
APART = 5.0
OUTSIDE, INSIDE = np.array([0.20, 0.44, 0.70]), np.array([0.93, 0.55, 0.22])
UNTOLD = 0.45 * INSIDE
"""sRGB-encoded, of the inside where no voxel was evaluated."""
FAR = 10.0
"""Metres: more than any distance."""
DIMMED = 0.55
"""Of the avatar's colours beside the plane."""


def over(
    frames: Sequence[DeferredFrame], picture: Float32[np.ndarray, "h w 4"], cut: Cut
) -> Float32[np.ndarray, "h w 4"]:
    """The plane over a picture of the frames, which is dimmed."""
    points, depth = plane(frames[0].camera, cut)
    rows = np.flatnonzero(np.isfinite(depth))
    made = DIMMED * picture.reshape(-1, 4)
    made[:, 3] = picture.reshape(-1, 4)[:, 3]
    values = nearest(frames, points[rows])
    shown = values < REACH
    rows, values = rows[shown], values[shown]
    colour, alpha = shade(values, depth[rows] / frames[0].camera.intrinsics[0, 0])
    made[rows] = np.column_stack([colour, np.ones(len(colour))]) * alpha[:, None] + made[rows] * (1 - alpha[:, None])
    return np.asarray(made.reshape(picture.shape), np.float32)


def plane(camera: Camera, cut: Cut) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Where the ray through each pixel's centre meets the plane, and its camera z; infinite where it does not."""
    row, column = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1) + 0.5
    pixel = np.column_stack([column, row, np.ones(len(row))])
    direction = pixel @ np.linalg.inv(camera.intrinsics).T @ camera.camera_from_world[:3, :3]
    along = direction[:, cut.row]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (cut.offset - camera.centre[cut.row]) / along
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.inf)
    with np.errstate(invalid="ignore"):
        points = camera.centre + depth[:, None] * direction
    return points, depth


def nearest(frames: Sequence[DeferredFrame], points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
    """The least of the figures' distances at points of the world; infinite where none was evaluated, −∞ inside one."""
    least = np.full(len(points), np.inf)
    for frame in frames:
        world, volume = frame.world_from_root, frame.volume.sdf
        own = torch.from_numpy((points - world[:3, 3]) @ world[:3, :3])
        told, signed = evaluated(volume, own).numpy(), distance(volume, own).numpy()
        least = np.minimum(least, np.where(told, signed, np.copysign(np.inf, signed)))
    return least


def evaluated(volume: SdfVolume, position: Float[torch.Tensor, "p 3"]) -> Bool[torch.Tensor, " p"]:
    """Whether a point of the root frame lies among voxels at which the field was evaluated, or in a part's box."""
    told = _within(volume.body, position)
    for part in volume.parts:
        told |= part.holds(position)
    return told


def _within(grid: BodyGrid, position: torch.Tensor) -> torch.Tensor:
    """In the body grid, and the nearest voxel of it is known."""
    index = ((position - torch.as_tensor(grid.origin).to(position)) / grid.voxel).round().long().flip(-1)
    size = torch.tensor(grid.sdf.shape)
    inside = ((index >= 0) & (index < size)).all(-1)
    if grid.known is not None:
        z, y, x = index.clamp(min=torch.zeros_like(size), max=size - 1).unbind(-1)
        inside &= torch.from_numpy(grid.known)[z, y, x]
    return inside


def shade(
    values: Float[np.ndarray, " p"], pixel: Float[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Colour and opacity of distances; `pixel`: metres of the plane that a pixel is wide."""
    alpha = STRONG * np.clip(1 - values / REACH, 0, 1)
    told, values = np.isfinite(values)[:, None], np.maximum(values, -FAR)
    depth = np.clip(np.abs(values) / REACH, 0, 1)[:, None]
    colour = np.where(values[:, None] < 0, INSIDE, OUTSIDE) * (1 - 0.35 * depth)
    step = np.where(pixel * APART < STEPS[0], *STEPS)
    off = np.abs(values - step * np.round(values / step)) / pixel
    line = np.clip(1.3 - off, 0, 1)[:, None]
    zero = np.clip(1.8 - np.abs(values) / pixel, 0, 1)[:, None]
    colour = colour * (1 - 0.55 * line)
    return np.where(told, colour * (1 - zero) + zero, UNTOLD), alpha
