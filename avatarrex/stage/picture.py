"""The picture behind a stage, read once as long as its file stays. Letters: a b rows and columns of the file, h w of the view."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatarrex.files.images import read_pixels
from avatarrex.stage.stage import PICTURE, Stage

MOST_SIDE = 4096
"""Pixels: a larger one is scaled down. Every OpenGL 4.3 has textures of four times as many."""
Stamp = tuple[str, int]
"""Path, and when its file was changed; 0 where it is not there."""


def stamp(path: str) -> Stamp:
    """What a picture that was read is kept by."""
    try:
        return path, Path(path).stat().st_mtime_ns
    except OSError:
        return path, 0


@lru_cache(1)
def read_picture(of: Stamp) -> UInt8[np.ndarray, "a b 3"]:
    """Its pixels. Raises `InputError` where it cannot be read."""
    pixels = read_pixels(of[0])
    image = Image.fromarray(pixels)
    image.thumbnail((MOST_SIDE, MOST_SIDE), Image.Resampling.LANCZOS)
    return pixels if image.size == pixels.shape[1::-1] else np.asarray(image)


@lru_cache(1)
def filled(of: Stamp, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture scaled about its middle until it fills (width, height). Raises `InputError`."""
    pixels, (width, height) = read_picture(of), size
    scale = max(width / pixels.shape[1], height / pixels.shape[0])
    across, down = width / scale, height / scale
    left, top = (pixels.shape[1] - across) / 2, (pixels.shape[0] - down) / 2
    box = (left, top, left + across, top + down)
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS, box))


def check_picture(stage: Stage) -> None:
    """Raise `InputError` where a stage that is shown has a picture that cannot be read."""
    if stage.shown and stage.backdrop == PICTURE:
        read_picture(stamp(stage.picture))
