"""Pictures of several cameras, from videos or folders of images, as numbered files. Letters: h w pixels.

`videos/<camera>.mp4` (.mov, .mkv, .avi, .webm; needs the `video` extra) or `images/<camera>/…`; mattes and pictures of the empty scene alike.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from avatarrex.errors import InputError
from avatarrex.files.gate import written
from avatarrex.files.images import NO_PICTURE

VIDEOS = (".mp4", ".mov", ".mkv", ".avi", ".webm")
IMAGES = (".jpg", ".jpeg", ".png")
QUALITY = 95
"""Of the JPEGs that a video becomes."""
_NUMBER = re.compile(r"(\d{1,9})(?!.*\d)")


@dataclass(frozen=True)
class Footage:
    """What one camera took: a video, or images by frame."""

    camera: str
    video: Path | None
    images: dict[int, Path]

    def frames(self, stride: int = 1) -> Iterator[tuple[int, np.ndarray]]:
        """Number and sRGB bytes (h, w, 3) of every `stride`-th frame. Raises `InputError` for one that cannot be decoded."""
        if self.video is not None:
            yield from ((number // stride, pixels) for number, pixels in _decoded(self.video) if number % stride == 0)
            return
        for number, path in sorted(self.images.items()):
            if number % stride == 0:
                yield number // stride, read_image(path)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first frame."""
        first = next(self.frames(), None)
        if first is None:
            raise InputError(self.video or self.camera, "", "a picture", "none")
        return first[1].shape[1], first[1].shape[0]

    @property
    def fps(self) -> float | None:
        """Of a video."""
        return None if self.video is None else _rate(self.video)


def find_footage(source: Path, folders: tuple[str, ...]) -> dict[str, Footage]:
    """By camera, in the first of `folders` of the source that is there; empty without any."""
    place = next((source / name for name in folders if (source / name).is_dir()), None)
    if place is None:
        return {}
    found = {}
    for entry in sorted(place.iterdir()):
        if entry.is_dir():
            images = {}
            for path in sorted(entry.iterdir()):
                match = _NUMBER.search(path.stem)
                if path.suffix.lower() in IMAGES and match:
                    images[int(match[1])] = path
            first = min(images, default=0)
            if images:
                found[entry.name] = Footage(entry.name, None, {number - first: path for number, path in images.items()})
        elif entry.suffix.lower() in VIDEOS:
            found[entry.stem] = Footage(entry.stem, entry, {})
        elif entry.suffix.lower() in IMAGES:
            found[entry.stem] = Footage(entry.stem, None, {0: entry})
    return found


def read_image(path: Path) -> np.ndarray:
    """(h, w, 3) bytes; of one with an alpha channel (h, w, 4). Raises `InputError`."""
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as picture:
            turned = ImageOps.exif_transpose(picture)
            return np.array(turned.convert("RGBA" if turned.has_transparency_data else "RGB"))
    except (*NO_PICTURE, EOFError) as error:
        raise InputError(path, "", "a whole PNG or JPEG", str(error).splitlines()[0]) from None


def save_jpeg(path: Path, pixels: np.ndarray) -> None:
    """(h, w, 3) bytes as a JPEG without chroma subsampling."""
    with written(path) as part:
        Image.fromarray(np.ascontiguousarray(pixels[..., :3])).save(part, format="JPEG", quality=QUALITY, subsampling=0)


def save_matte(path: Path, matte: np.ndarray) -> None:
    """(h, w) bytes as PNG."""
    with written(path) as part:
        Image.fromarray(matte).save(part, format="PNG")


def _decoded(path: Path) -> Iterator[tuple[int, np.ndarray]]:
    av = _library(path)
    try:
        with av.open(str(path)) as container:
            for number, frame in enumerate(container.decode(video=0)):
                yield number, frame.to_ndarray(format="rgb24")
    except (av.error.FFmpegError, IndexError, OSError) as error:
        raise InputError(
            path, "", "a video that can be decoded", str(error).splitlines()[0] if str(error) else "none"
        ) from None


def _rate(path: Path) -> float | None:
    av = _library(path)
    try:
        with av.open(str(path)) as container:
            rate = container.streams.video[0].average_rate
            return float(rate) if rate else None
    except (av.error.FFmpegError, IndexError, OSError) as error:
        raise InputError(
            path, "", "a video that can be decoded", str(error).splitlines()[0] if str(error) else "none"
        ) from None


def _library(path: Path):  # type: ignore[no-untyped-def]
    try:
        import av
    except ImportError:
        raise InputError(path, "", "the 'video' extra: pip install 'avatarrex-studio[video]'", "no PyAV") from None
    return av
