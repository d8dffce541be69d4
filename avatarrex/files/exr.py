"""Layers of a picture as one OpenEXR file: floating-point channels that compositing programs read.

Colours are premultiplied and linear in an EXR, with the Rec. 709 primaries that sRGB has. Letters: h w image rows and columns,
c channels. Needs the `exr` extra (OpenEXR).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from avatarrex.errors import InputError
from avatarrex.files.gate import written

NAMES = {1: ("",), 3: (".X", ".Y", ".Z")}
"""Endings of the channels of a layer, by their number."""


def check_exr(path: str | Path) -> None:
    """Raise `InputError` where OpenEXR is not installed."""
    _library(path)


def write_exr(
    path: str | Path,
    image: Float[np.ndarray, "h w 4"],
    layers: Mapping[str, np.ndarray],
    text: Mapping[str, str] | None = None,
) -> None:
    """A premultiplied sRGB-encoded `image` as R, G, B, A (half precision, linear) and `layers` beside it (32 bits).

    A layer (h, w) is one channel of its name, one of (h, w, 3) NAME.X, NAME.Y, NAME.Z. `text`: attributes of the header.
    Raises `InputError` where the file cannot be written, and without OpenEXR.
    """
    library = _library(path)
    colour, alpha = linear_premultiplied(image)
    channels = {name: np.ascontiguousarray(colour[..., k], np.float16) for k, name in enumerate("RGB")}
    channels["A"] = np.ascontiguousarray(alpha, np.float16)
    for name, values in layers.items():
        planes = values[..., None] if values.ndim == 2 else values
        for k, ending in enumerate(NAMES[planes.shape[-1]]):
            channels[name + ending] = np.ascontiguousarray(planes[..., k], np.float32)
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage, **(text or {})}
    with written(path) as temporary, library.File(header, channels) as file:
        file.write(str(temporary))


def linear_premultiplied(image: Float[np.ndarray, "h w 4"]) -> tuple[np.ndarray, np.ndarray]:
    """Linear premultiplied colour (h, w, 3) and alpha (h, w) of a premultiplied sRGB-encoded picture."""
    alpha = np.clip(image[..., 3], 0, 1)
    straight = np.clip(image[..., :3] / np.maximum(alpha, 1e-6)[..., None], 0, 1)
    linear = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4)
    return linear * alpha[..., None], alpha


def _library(path: str | Path) -> Any:
    try:
        import OpenEXR
    except ImportError:
        remedy = "the 'exr' extra: pip install 'avatarrex-studio[exr]'"
        raise InputError(path, "", remedy, "OpenEXR is not installed") from None
    return OpenEXR
