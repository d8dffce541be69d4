"""A figure over a stage: its floor over its background, and the exposure of all.

    behind = background · (1 + pool) · shade,   1 − alpha' = (1 − alpha) · shade        shade = 1 − shadow · (1 − brightness)
    picture = gain · (figure + (1 − α) · behind)

A shadow is black of opacity 1 − shade, so that it lies over nothing, too, where the background is transparent. The floor is the
background, with a pool of light about the figure: no line where it ends. `shaders/window/stage.frag` has the same.

Letters: h w pixels. World frame, metres; sRGB-encoded, premultiplied unless told.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.files.images import Colour
from avatarrex.stage.picture import filled, stamp
from avatarrex.stage.stage import COLOUR, PICTURE, KeyLight, Stage
from avatarrex.surface.floor import FADE, FloorLight, brightness

POOL, POOL_RADIUS = 0.16, 2.2
"""How much brighter the floor is under the figure, and the metres over which that falls to nothing."""


def staged(
    image: Float[Tensor, "h w 4"],
    camera: Camera,
    stage: Stage,
    background: Colour,
    floor: FloorLight | None,
    place: tuple[float, float],
) -> UInt8[np.ndarray, "h w 4"]:
    """The picture, straight-alpha bytes. `background` is that of a stage without one of its own; `place`: the figure's x and z.

    Raises `InputError` where a picture cannot be read.
    """
    behind = backdrop(stage, background, (camera.width, camera.height))
    light = stage.light
    if light is not None and light.floor:
        behind = _on_floor(behind, camera, light, floor, place, POOL * (stage.backdrop != PICTURE))
    figure = image.detach().cpu().double().numpy()
    pixels = figure + (1 - figure[..., 3:]) * behind
    straight = stage.gain * pixels[..., :3] / np.maximum(pixels[..., 3:], 1e-6)
    return np.asarray(np.rint(255 * np.clip(np.concatenate([straight, pixels[..., 3:]], -1), 0, 1)), np.uint8)


def backdrop(stage: Stage, background: Colour, size: tuple[int, int]) -> Float[np.ndarray, "h w 4"]:
    """What is behind floor and figure."""
    width, height = size
    made = np.ones((height, width, 4))
    if stage.backdrop == PICTURE:
        made[..., :3] = filled(stamp(stage.picture), size) / 255
    elif stage.backdrop == COLOUR:
        made[:] = [*(background[3] * channel for channel in background[:3]), background[3]]
    else:
        share = ((np.arange(height) + 0.5) / height)[:, None, None]
        made[..., :3] = (1 - share) * np.array(stage.top) + share * np.array(stage.bottom)
    return made


def _on_floor(
    behind: Float[np.ndarray, "h w 4"],
    camera: Camera,
    light: KeyLight,
    floor: FloorLight | None,
    place: tuple[float, float],
    pool: float,
) -> Float[np.ndarray, "h w 4"]:
    """`behind` where the floor is seen: lit about the figure, and in its shadow."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    inverse = camera.camera_from_world[:3, :3].T @ np.linalg.inv(camera.intrinsics)
    ray = np.stack([column, row, np.ones_like(row)], -1) @ inverse.T
    eye = camera.centre
    above = eye[1] - light.height
    seen = (ray[..., 1] < 0) & (above > 0)
    t = above / np.where(seen, -ray[..., 1], 1)
    x, z = eye[0] + t * ray[..., 0], eye[2] + t * ray[..., 2]
    near = np.maximum(1 - ((x - place[0]) ** 2 + (z - place[1]) ** 2) / POOL_RADIUS**2, 0) ** 2
    shade = 1 - light.shadow * (1 - _brightness(floor, x, z)) if floor else np.ones_like(x)
    gain, shade = np.where(seen, 1 + pool * near, 1)[..., None], np.where(seen, shade, 1)[..., None]
    alpha = behind[..., 3:]
    return np.concatenate([np.minimum(behind[..., :3] * gain, alpha) * shade, 1 - (1 - alpha) * shade], -1)


def _brightness(floor: FloorLight, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """At points of the floor: bilinear in the map, fading to 1 at its border."""
    x0, z0, x1, z1 = floor.region
    side = floor.values.shape[0]
    values = brightness(floor.values / 255.0)
    u, v = np.clip((x - x0) / (x1 - x0), 0, 1) * side - 0.5, np.clip((z - z0) / (z1 - z0), 0, 1) * side - 0.5
    u, v = np.clip(u, 0, side - 1), np.clip(v, 0, side - 1)
    left, top = np.minimum(u.astype(int), side - 2), np.minimum(v.astype(int), side - 2)
    u, v = u - left, v - top
    above = values[top, left] * (1 - u) + values[top, left + 1] * u
    below = values[top + 1, left] * (1 - u) + values[top + 1, left + 1] * u
    border = np.minimum(np.minimum(x - x0, x1 - x), np.minimum(z - z0, z1 - z))
    share = np.clip(border / FADE, 0, 1)
    return np.asarray(1 - share * (1 - (above * (1 - v) + below * v)))
