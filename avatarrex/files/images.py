"""Images and passes on disk: PNG, JPEG, `.npz`, written under a temporary name and then renamed.

A file with its final name is always whole. In memory colours are premultiplied sRGB-encoded RGBA in [0, 1]; in files
alpha is straight. Letters: h w image rows and columns.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageOps, PngImagePlugin
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.gate import read_bytes
from avatarrex.files.gate import write_text as write_text
from avatarrex.files.gate import written as written
from avatarrex.files.whole_picture import check_whole

NO_PICTURE = (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning)
"""What Pillow raises for what is no picture; ValueError: text that unpacks to megabytes."""
Colour = tuple[float, float, float, float]


def composite(image: Float[Tensor, "h w 4"], background: Colour) -> UInt8[np.ndarray, "h w 4"]:
    """Premultiplied `image` over a straight-alpha `background` colour, as straight-alpha bytes."""
    pixels = image.detach().cpu().double().numpy()
    alpha = background[3]
    below = np.array([*(alpha * channel for channel in background[:3]), alpha])
    pixels = pixels + (1 - pixels[..., 3:]) * below
    covered = np.maximum(pixels[..., 3:], 1e-6)  # below half a step of 8 bits: colour is then irrelevant
    straight = np.concatenate([pixels[..., :3] / covered, pixels[..., 3:]], -1)
    return np.asarray(np.rint(255 * np.clip(straight, 0, 1)), np.uint8)


def write_png(path: str | Path, pixels: UInt8[np.ndarray, "h w 4"], text: Mapping[str, str] | None = None) -> None:
    """Straight-alpha RGBA bytes as PNG; an opaque image is stored as RGB. `text` becomes PNG text fields."""
    fields = PngImagePlugin.PngInfo()
    for name, value in (text or {}).items():
        fields.add_itxt(name, value)
    opaque = bool((pixels[..., 3] == 255).all())
    with written(path) as temporary:
        Image.fromarray(pixels[..., :3] if opaque else pixels).save(temporary, format="PNG", pnginfo=fields)


def write_jpeg(path: str | Path, pixels: UInt8[np.ndarray, "h w 4"], text: str = "", quality: int = 95) -> None:
    """Opaque RGBA bytes as JPEG of a quality from 1 to 100; `text` becomes its comment."""
    with written(path) as temporary:
        picture = Image.fromarray(np.ascontiguousarray(pixels[..., :3]))
        picture.save(temporary, format="JPEG", quality=quality, subsampling=0, comment=text.encode())


def read_jpeg_text(path: str | Path) -> tuple[tuple[int, int], str | None]:
    """Width and height of a JPEG, and its comment, None without one; no pixel is decoded. Raises `InputError`."""
    content = read_bytes(path, "a JPEG")
    try:
        with Image.open(io.BytesIO(content), formats=("JPEG",)) as picture:
            comment = picture.info.get("comment")
            return picture.size, comment.decode("utf-8", "replace") if comment else None
    except NO_PICTURE as error:
        raise InputError(path, "", "a JPEG", str(error).splitlines()[0]) from None


def read_pixels(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Red, green and blue of a PNG or JPEG, turned as its EXIF says. Raises `InputError`."""
    content = read_bytes(path, "a PNG or JPEG")
    try:
        with Image.open(io.BytesIO(content), formats=("PNG", "JPEG")) as picture:
            check_whole(content, np.asarray(picture), path)
            return np.asarray(ImageOps.exif_transpose(picture).convert("RGBA"))[..., :3].copy()
    except InputError:
        raise
    except NO_PICTURE as error:
        raise InputError(path, "", "a PNG or JPEG", str(error).splitlines()[0]) from None


def read_png_text(path: str | Path, name: str) -> tuple[tuple[int, int], str | None]:
    """Width and height of a PNG, and its text field `name`, None without it; no pixel is decoded. Raises `InputError`."""
    content = read_bytes(path, "a PNG")
    try:
        with Image.open(io.BytesIO(content), formats=("PNG",)) as picture:
            return picture.size, picture.info.get(name)
    except NO_PICTURE as error:
        raise InputError(path, "", "a PNG", str(error).splitlines()[0]) from None


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Named arrays as a compressed `.npz`."""
    with written(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
