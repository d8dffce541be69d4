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
SIZED = 5
"""Images of a camera that are looked at for their size."""
ORIENTATION, SIDEWAYS = 0x0112, (5, 6, 7, 8)
"""EXIF's tag, and its values that exchange width and height."""
_NUMBER = re.compile(r"(\d{1,9})(?!.*\d)")


@dataclass(frozen=True)
class Footage:
    """What one camera took: a video, or images by frame."""

    camera: str
    video: Path | None
    images: dict[int, Path]
    """By the number in their names."""
    first: int = 0
    """The number that frame 0 has."""

    def frames(self, stride: int = 1, problems: list[str] | None = None) -> Iterator[tuple[int, np.ndarray]]:
        """Number and sRGB bytes (h, w, 3) of every `stride`-th frame.

        What cannot be decoded is left out and said in `problems`; without them it raises `InputError`.
        """
        if self.video is not None:
            yield from _decoded(self.video, stride, problems)
            return
        for number, path in sorted(self.images.items()):
            frame = number - self.first
            if frame < 0 or frame % stride:
                continue
            try:
                pixels = read_image(path)
            except InputError as error:
                if problems is None:
                    raise
                problems.append(f"{path.name}: expected {error.expected}, found {error.found}")
                continue
            yield frame // stride, pixels

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first frame; of images what most of the first have. Raises `InputError` without any."""
        if self.video is not None:
            sizes = [(pixels.shape[1], pixels.shape[0]) for _, (_, pixels) in zip(range(1), self.frames())]
        else:
            paths = [path for number, path in sorted(self.images.items()) if number >= self.first]
            sizes = [size for path in paths[:SIZED] if (size := _size(path))]
        if not sizes:
            raise InputError(self.video or self.camera, "", "a picture", "none")
        return max(sizes, key=sizes.count)

    @property
    def fps(self) -> float | None:
        """Of a video."""
        return None if self.video is None else _rate(self.video)


def find_footage(source: Path, folders: tuple[str, ...], first: int | None = None) -> dict[str, Footage]:
    """By camera, in the first of `folders` of the source that is there; empty without any.

    Frame 0 of folders of images is the one numbered `first`, for all cameras; unless given, the lowest number that any of them has.
    """
    place = next((source / name for name in folders if (source / name).is_dir()), None)
    if place is None:
        return {}
    found, numbered, single = {}, {}, {}
    for entry in sorted(place.iterdir()):
        if entry.is_dir():
            if images := _images(entry):
                numbered[entry.name] = images
        elif entry.suffix.lower() in VIDEOS:
            found[entry.stem] = Footage(entry.stem, entry, {})
        elif entry.suffix.lower() in IMAGES:
            single[entry.stem] = entry
    lowest = min((min(images) for images in numbered.values()), default=0) if first is None else first
    numbered |= {name: {lowest: path} for name, path in single.items()}
    return found | {name: Footage(name, None, images, lowest) for name, images in numbered.items()}


def _images(folder: Path) -> dict[int, Path]:
    """By the last number in their names."""
    found = {}
    for path in sorted(folder.iterdir()):
        match = _NUMBER.search(path.stem)
        if path.suffix.lower() in IMAGES and match:
            found[int(match[1])] = path
    return found


def _size(path: Path) -> tuple[int, int] | None:
    """Width and height as shown, by the header alone; None of what is no picture, which is said when it is read."""
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as picture:
            turned = picture.getexif().get(ORIENTATION, 1) in SIDEWAYS
            width, height = picture.size
            return (height, width) if turned else (width, height)
    except (*NO_PICTURE, EOFError):
        return None


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


def _decoded(path: Path, stride: int, problems: list[str] | None) -> Iterator[tuple[int, np.ndarray]]:
    """Frames as they are shown: turned as the file's display matrix says. A video ends where it cannot be decoded."""
    av = _library(path)
    number = -1
    try:
        with av.open(str(path)) as container:
            for number, frame in enumerate(container.decode(video=0)):
                if number % stride == 0:
                    pixels = frame.to_ndarray(format="rgb24")
                    yield number // stride, np.rot90(pixels, round(frame.rotation / 90))
    except (av.error.FFmpegError, IndexError, OSError) as error:
        found = str(error).splitlines()[0] if str(error) else "none"
        if problems is None or number < 0:
            raise InputError(path, "", "a video that can be decoded", found) from None
        problems.append(f"{path.name}: expected a video that can be decoded, found {found} after {number + 1} frames")


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
