"""Images, passes and videos on disk: PNG, JPEG, `.npz`, `.mp4` and `.webm`, written under a temporary name and then renamed.

A file with its final name is always whole. In memory colours are premultiplied sRGB-encoded RGBA in [0, 1]; in files
alpha is straight. Letters: h w image rows and columns.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, PngImagePlugin
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.gate import read_bytes
from avatarrex.files.gate import write_text as write_text
from avatarrex.files.gate import written as written

NO_PICTURE = (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning)
"""What Pillow raises for what is no picture; ValueError: text that unpacks to megabytes."""
Append = Callable[[np.ndarray], None]
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
    """Red, green and blue of a PNG or JPEG. Raises `InputError`."""
    content = read_bytes(path, "a PNG or JPEG")
    try:
        with Image.open(io.BytesIO(content), formats=("PNG", "JPEG")) as picture:
            return np.asarray(picture.convert("RGBA"))[..., :3].copy()
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


VIDEOS = (".mp4", ".webm")
"""H.264, whose alpha is ignored, and VP9 with alpha."""


def video_writer(path: str | Path, width: int, height: int, fps: float) -> AbstractContextManager[Append]:
    """A block's `append(pixels)` adds a frame, (height, width, 4) straight-alpha bytes, to a video with even sides: one of `VIDEOS`.

    The file is there once the block ends well. Needs the `video` extra (PyAV). Raises `InputError`.
    """
    if width % 2 or height % 2:
        raise InputError(path, "size", "even sides for a video", f"{width}x{height}")
    if not 0.001 <= fps <= 1000:
        raise InputError(path, "fps", "a number from 0.001 to 1000", fps)
    try:
        import av
    except ImportError:
        raise InputError(path, "", "the 'video' extra: pip install 'avatarrex-studio[video]'", "no PyAV") from None
    return _video(av, Path(path), (width, height), Fraction(fps).limit_denominator(1001))


@contextmanager
def _video(av: Any, path: Path, size: tuple[int, int], rate: Fraction) -> Iterator[Append]:
    clear = path.suffix.lower() == ".webm"
    with written(path) as temporary, av.open(str(temporary), "w", format="webm" if clear else "mp4") as container:
        stream = container.add_stream("libvpx-vp9" if clear else "libx264", rate=rate)
        (stream.width, stream.height), stream.pix_fmt = size, "yuva420p" if clear else "yuv420p"
        quick = {"crf": "18", "b": "0", "deadline": "good", "cpu-used": "5", "row-mt": "1"}
        stream.options = quick if clear else {"crf": "16", "preset": "medium"}
        channels, form = (4, "rgba") if clear else (3, "rgb24")

        def append(pixels: UInt8[np.ndarray, "h w 4"]) -> None:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels[..., :channels]), format=form)
            container.mux(stream.encode(frame))

        yield append
        container.mux(stream.encode())
