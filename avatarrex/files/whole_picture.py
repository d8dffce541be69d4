"""Pictures of which a part is missing although Pillow reads them: a PNG whose stream ends early, a JPEG that is grey from some row on.

Pillow fills the missing rows of a PNG with zeros; libjpeg those of a JPEG, where its end follows too early, with the middle of its range.
So a file is looked at closely only where its last row is of these.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from jaxtyping import Shaped

from avatarrex.errors import InputError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""By a PNG's colour type."""
PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""Of an interlaced PNG: first column and row, and their steps."""
BLOCK = 2**20
GREY, ROWS = 128, 8
"""What libjpeg fills with, and the rows of its smallest block."""


def check_whole(content: bytes, pixels: Shaped[np.ndarray, "h w *c"], source: object) -> None:
    """Raise `InputError` where rows of a decoded picture were not in its file."""
    if content.startswith(SIGNATURE):
        if not pixels[-1].any():
            _check_png(content, source)
    elif len(pixels) > ROWS and (pixels[-ROWS:] == GREY).all() and not (pixels[:ROWS] == GREY).all():
        grey = (pixels == GREY).reshape(len(pixels), -1).all(1)
        there = len(pixels) - int(np.argmin(grey[::-1]))
        raise InputError(
            source, "", "a whole picture", f"nothing below row {there} of {len(pixels)}: all is middle grey"
        )


def _check_png(content: bytes, source: object) -> None:
    """Compare the bytes that a PNG's stream unpacks to with those that its header announces."""
    announced, stream, place = 0, zlib.decompressobj(), len(SIGNATURE)
    found = 0
    while place + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, place)
        data = content[place + 8 : place + 8 + length]
        place += 12 + length
        if kind == b"IHDR":
            announced = _announced(data)
        while kind == b"IDAT" and data and not stream.eof:
            found += len(stream.decompress(data, BLOCK))
            data = stream.unconsumed_tail
    if found < announced:
        raise InputError(source, "", "a whole picture", f"{found / announced:.0%} of its pixels")


def _announced(header: bytes) -> int:
    """Bytes of all rows, each with its filter."""
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    passes = PASSES if interlaced else ((0, 0, 1, 1),)
    total = 0
    for column, row, across, down in passes:
        columns, rows = -(-(width - column) // across), -(-(height - row) // down)
        if columns > 0 and rows > 0:
            total += rows * (1 + -(-columns * depth * CHANNELS[colour] // 8))
    return total
