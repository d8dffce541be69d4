"""What one subject of a comparison shows of itself to one camera: its picture, and the surface under each pixel.

Letters: h w pixels. World metres; colours sRGB-encoded, premultiplied, so that what is not covered is black.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float32
from PIL import Image
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.frame import Frame
from avatarrex.levels import DEFAULT_LEVEL, LEVELS
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals


@dataclass(frozen=True, eq=False)
class Drawing:
    """A picture with its geometry."""

    image: Float32[Tensor, "h w 4"]
    """Premultiplied colour and coverage."""
    position: Float32[np.ndarray, "h w 3"]
    """World metres; zero where nothing is hit."""
    normal: Float32[np.ndarray, "h w 3"]
    """Unit, outwards."""
    hit: Bool[np.ndarray, "h w"]


@runtime_checkable
class Drawer(Protocol):
    """Who draws a subject of comparison."""

    name: str

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """The subject under `signals`, seen by `camera` (world)."""


class AvatarDrawer:
    """The avatar at a level; cameras after one another on one pose share its volume."""

    def __init__(
        self,
        avatar: Avatar,
        samples: int = 1,
        settings: RenderSettings | None = None,
        render: Callable[..., Frame] = render_frame,
        name: str = "avatar",
    ) -> None:
        """`settings`: `balanced` unless given; `samples` along each side of a pixel are averaged; 1 is what the studio shows."""
        self.name = name
        self._avatar, self._samples, self._settings, self._render = avatar, samples, settings, render
        self._previous: Frame | None = None

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """The avatar's frame; its geometry is that of one sample near each pixel's centre."""
        s, height, width = self._samples, camera.height, camera.width
        fine = camera if s == 1 else camera.resized(width * s, height * s)
        frame = self._render(self._avatar, signals, fine, self._settings, self._previous)
        self._previous = frame
        points, world = frame.pointmap, frame.world_from_root
        pick = (slice(s // 2, None, s), slice(s // 2, None, s))
        hit = points.hit[pick].cpu().numpy()
        position = points.position[pick].double().cpu().numpy() @ world[:3, :3].T + world[:3, 3]
        normal = points.normal[pick].double().cpu().numpy() @ world[:3, :3].T
        image = frame.image.cpu().float().reshape(height, s, width, s, 4).mean((1, 3))
        return Drawing(image, _seen(position, hit), _seen(normal, hit), hit)


def by_level(name: str, avatar: Avatar, levels: Sequence[str], samples: int) -> list[AvatarDrawer]:
    """A drawer for each of `levels`: `name` alone is the avatar at `DEFAULT_LEVEL`."""
    names = {level: name if level == DEFAULT_LEVEL else f"{name}, {level}" for level in levels}
    return [AvatarDrawer(avatar, samples, LEVELS[level], name=names[level]) for level in levels]


@dataclass(frozen=True, eq=False)
class Truth:
    """A captured picture over black."""

    image: Float32[Tensor, "h w 3"]
    """Premultiplied by the matte."""
    matte: Float32[Tensor, "h w"]

    def layers(self) -> Float32[np.ndarray, "h w 4"]:
        """Both."""
        return np.dstack([self.image.numpy(), self.matte.numpy()])


def over_black(image: np.ndarray, matte: np.ndarray, width: int, height: int) -> Truth:
    """An image (h, w, 3) with its matte (h, w), both bytes, box-filtered to `width` x `height`."""
    alpha = matte.astype(np.float32) / 255
    colour = image.astype(np.float32) / 255 * alpha[..., None]
    layers = [Image.fromarray(layer) for layer in (*np.moveaxis(colour, -1, 0), alpha)]
    averaged = [np.array(layer.resize((width, height), Image.Resampling.BOX)) for layer in layers]
    return Truth(torch.from_numpy(np.stack(averaged[:3], -1)), torch.from_numpy(averaged[3]))


def fitted(camera: Camera, size: int | None) -> Camera:
    """The same view with at most `size` pixels on its longer side."""
    longest = max(camera.width, camera.height)
    if size is None or size >= longest:
        return camera
    width, height = (max(round(side * size / longest), 1) for side in (camera.width, camera.height))
    return camera.resized(width, height)


def _seen(values: np.ndarray, hit: np.ndarray) -> np.ndarray:
    return np.where(hit[..., None], values, 0).astype(np.float32)
