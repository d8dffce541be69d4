"""Pictures and mattes of a capture of another layout: whether they are whole, and mattes as ours are, white the person.

What a camera's mattes mean is told by the first of them: shares of foreground (white is the person), labels (whatever is
not 0 is the person), or inverted ones (white is the background). Letters: h w pixels.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from itertools import islice

import numpy as np
from PIL import Image

from avatarrex.capture.readers.archive import PICTURE_BYTES, Archive
from avatarrex.errors import InputError
from avatarrex.files.images import NO_PICTURE

RULES = {
    "grey": "white is the person",
    "labels": "labels: whatever is not 0 is the person",
    "inverted": "white is the background: inverted",
}
MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
"""8 bits a channel at most."""
SIZED = 5
"""Pictures of a camera that are looked at for their size."""
LARGEST_LABEL = 127
"""A matte without a brighter pixel holds labels."""
MOSTLY = 0.5
"""Share of the border, and of the picture, that is white in an inverted matte."""


def open_picture(archive: Archive, name: str) -> Image.Image:
    """A JPEG or PNG, its header alone read. Raises `InputError`."""
    try:
        picture = Image.open(io.BytesIO(archive.read(name, PICTURE_BYTES)), formats=("PNG", "JPEG"))
    except NO_PICTURE as error:
        if isinstance(error, InputError):
            raise
        raise InputError(archive.place(name), "", "a JPEG or PNG picture", str(error).splitlines()[0]) from None
    if picture.mode not in MODES:
        raise InputError(archive.place(name), "", "8 bits a channel, grey or RGB", f"mode {picture.mode}")
    return picture


def picture_size(archive: Archive, name: str) -> tuple[int, int]:
    """Width and height. Raises `InputError`."""
    return open_picture(archive, name).size


def usual_size(archive: Archive, names: Iterable[str]) -> tuple[int, int]:
    """Width and height that most of the first pictures have. Raises `InputError` where none of them can be read."""
    sizes: list[tuple[int, int]] = []
    refused: InputError | None = None
    for name in islice(names, SIZED):
        try:
            sizes.append(picture_size(archive, name))
        except InputError as error:  # one of the problems when it is its turn
            refused = error
    if not sizes:
        raise refused or InputError(archive.path, "", "pictures", "none")
    return max(sizes, key=sizes.count)


def check_picture(archive: Archive, name: str, size: tuple[int, int]) -> None:
    """Raise `InputError` for a picture that is not whole, or of another size."""
    picture = _sized(archive, name, size)
    picture.draft("L", (size[0] // 8, size[1] // 8))
    _decoded(archive, name, picture)


def matte_values(archive: Archive, name: str, size: tuple[int, int]) -> np.ndarray:
    """(h, w) bytes as they are in the file: of a palette its indices. Raises `InputError`."""
    picture = _sized(archive, name, size)
    values = _decoded(archive, name, picture)
    if picture.mode in ("P", "L"):
        return values
    return np.array(picture.convert("RGBA").getchannel("A") if picture.mode in ("LA", "RGBA") else picture.convert("L"))


def matte_rule(mattes: Iterable[np.ndarray]) -> str:
    """One of `RULES`, by the first of some mattes (h, w) with a bright pixel; labels, where none has one, but some show anything."""
    highest = 0
    for values in mattes:
        highest = max(highest, int(values.max(initial=0)))
        if highest <= LARGEST_LABEL:
            continue
        border = np.concatenate([values[0], values[-1], values[:, 0], values[:, -1]]) > LARGEST_LABEL
        white = (values > LARGEST_LABEL).mean()
        return "inverted" if border.mean() > MOSTLY and white > MOSTLY else "grey"
    return "labels" if highest else "grey"


def as_matte(values: np.ndarray, rule: str) -> np.ndarray:
    """(h, w) bytes, white the person."""
    if rule == "labels":
        return np.asarray(np.where(values > 0, 255, 0), np.uint8)
    return np.asarray(255 - values if rule == "inverted" else values, np.uint8)


def _sized(archive: Archive, name: str, size: tuple[int, int]) -> Image.Image:
    picture = open_picture(archive, name)
    if picture.size != size:
        found = f"{picture.size[0]}x{picture.size[1]}"
        raise InputError(archive.place(name), "", f"{size[0]}x{size[1]} pixels, as the calibration says", found)
    return picture


def _decoded(archive: Archive, name: str, picture: Image.Image) -> np.ndarray:
    try:
        return np.array(picture)
    except (*NO_PICTURE, EOFError) as error:
        raise InputError(archive.place(name), "", "a whole picture", str(error).splitlines()[0]) from None
