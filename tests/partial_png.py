"""PNG files with a whole stream of some of their rows alone."""

from __future__ import annotations

import struct
import zlib

import numpy as np


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def partial_png(pixels: np.ndarray, rows: int, pieces: int = 1) -> bytes:
    """The first `rows` of (h, w, 3) bytes, their stream in pieces."""
    stream = zlib.compress(b"".join(b"\0" + row.tobytes() for row in pixels[:rows]))
    step = -(-len(stream) // pieces)
    head = struct.pack(">IIBBBBB", pixels.shape[1], len(pixels), 8, 2, 0, 0, 0)
    data = b"".join(chunk(b"IDAT", stream[k : k + step]) for k in range(0, len(stream), step))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + data + chunk(b"IEND", b"")
