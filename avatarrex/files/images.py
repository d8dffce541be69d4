"""Images, passes and videos on disk: PNG, `.npz` and `.mp4`, written under a temporary name and then renamed.

A file with its final name is always whole. In memory colours are premultiplied sRGB-encoded RGBA in [0, 1]; in files
alpha is straight. Letters: h w image rows and columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, PngImagePlugin
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.gate import write_text as write_text
from avatarrex.files.gate import written as written

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


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Named arrays as a compressed `.npz`."""
    with written(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


class VideoWriter:
    """An H.264 `.mp4` of opaque frames with even sides; use as a context manager. Needs the `video` extra (PyAV)."""

    def __init__(self, path: str | Path, width: int, height: int, fps: float) -> None:
        if width % 2 or height % 2:
            raise InputError(path, "size", "even sides for H.264", f"{width}x{height}")
        if not 0.001 <= fps <= 1000:
            raise InputError(path, "fps", "a number from 0.001 to 1000", fps)
        self._av = _av(path)
        self._path, self._size, self._rate = path, (width, height), Fraction(fps).limit_denominator(1001)

    def __enter__(self) -> VideoWriter:
        self._file = written(self._path)
        temporary = self._file.__enter__()
        try:
            self._container = self._av.open(str(temporary), "w", format="mp4")
            self._stream = self._container.add_stream("libx264", rate=self._rate)
        except Exception as error:
            self._file.__exit__(type(error), error, error.__traceback__)
            raise
        self._stream.width, self._stream.height = self._size
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": "16", "preset": "medium"}
        return self

    def write(self, pixels: UInt8[np.ndarray, "h w 4"]) -> None:
        """Append one frame, (height, width, 4) bytes; alpha is ignored."""
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels[..., :3]), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._container.mux(self._stream.encode())
            self._container.close()
        except Exception as failure:
            self._file.__exit__(type(failure), failure, failure.__traceback__)
            raise
        self._file.__exit__(kind, error, trace)


def _av(path: str | Path) -> Any:
    try:
        import av
    except ImportError:
        raise InputError(path, "", "the 'video' extra: pip install 'avatarrex-studio[video]'", "no PyAV") from None
    return av
