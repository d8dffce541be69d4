"""What the frames of a picture contain beside it, as arrays of the world: depth, normals, positions, coverage."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from torch import Tensor

from avatarrex.frame import Frame


def passes(frames: Sequence[Frame], names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The named passes of one picture's frames, and `hit`: float32, world space, metres.

    Zero where the ray through the pixel's centre misses.
    depth (h, w) along the camera's axis; normal, position (h, w, 3); mask (h, w) coverage from 0 to 1.
    """
    depth, figure = nearest(frames)
    made: dict[str, Callable[[], np.ndarray]] = {
        "depth": lambda: depth,
        "normal": lambda: _of_the_nearest([_normals(frame) for frame in frames], figure),
        "position": lambda: _of_the_nearest([_positions(frame) for frame in frames], figure),
        "mask": lambda: 1 - np.prod([1 - _seen(frame.pointmap.coverage) for frame in frames], axis=0),
    }
    return {**{name: made[name]().astype(np.float32) for name in names}, "hit": depth > 0}


def nearest(frames: Sequence[Frame]) -> tuple[Float32[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]:
    """Of the frames of one picture: camera z of what the ray through each pixel's centre meets first, metres, and which frame it is of.

    Both 0 where it meets nothing.
    """
    depths = [torch.where(frame.pointmap.hit, frame.pointmap.depth, torch.inf).float().cpu() for frame in frames]
    found = torch.stack(depths).min(0)
    depth = torch.where(found.values.isfinite(), found.values, 0.0)
    return depth.numpy(), found.indices.to(torch.uint8).numpy()


def _of_the_nearest(values: list[np.ndarray], figure: UInt8[np.ndarray, "h w"]) -> Float64[np.ndarray, "h w 3"]:
    """Of each pixel those of the figure that is nearest."""
    return np.asarray(np.take_along_axis(np.stack(values), figure[None, ..., None].astype(np.int64), 0)[0])


def _seen(values: Tensor) -> np.ndarray:
    return np.asarray(values.double().cpu().numpy())


def _normals(frame: Frame) -> np.ndarray:
    """(h, w, 3), world."""
    return np.asarray(
        _seen(frame.pointmap.normal) @ frame.world_from_root[:3, :3].T * _seen(frame.pointmap.hit)[..., None]
    )


def _positions(frame: Frame) -> np.ndarray:
    """(h, w, 3), world."""
    world = frame.world_from_root
    inside = _seen(frame.pointmap.hit)[..., None]
    return np.asarray((_seen(frame.pointmap.position) @ world[:3, :3].T + world[:3, 3]) * inside)
