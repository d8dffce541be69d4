"""Sound files. Letters: s samples."""

from __future__ import annotations

import io
import wave
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from avatarrex.errors import InputError
from avatarrex.files.gate import read_bytes

MOST_BYTES = 2**28


def read_sound(path: Path) -> tuple[Float64[np.ndarray, " s"], int]:
    """Of a `.wav` of 8 to 32 bits the mean of all channels, −1 to 1, and samples a second. Raises `InputError`."""
    try:
        with wave.open(io.BytesIO(read_bytes(path, "a sound file", MOST_BYTES))) as file:
            channels, width, rate = file.getnchannels(), file.getsampwidth(), file.getframerate()
            data = file.readframes(file.getnframes())
    except (wave.Error, EOFError, RuntimeError) as error:
        raise InputError(path, "", "a .wav file of plain numbers (PCM)", error) from None
    if width not in (1, 2, 3, 4) or not 4000 <= rate <= 400_000 or not 1 <= channels <= 64:
        raise InputError(
            path, "format", "8 to 32 bits, 4 to 400 kHz", f"{8 * width} bits, {rate} Hz, {channels} channels"
        )
    data = data[: len(data) // (width * channels) * width * channels]
    if not data:
        raise InputError(path, "length", "at least one sample", 0)
    if width == 1:
        values = np.frombuffer(data, np.uint8).astype(np.float64) - 128
    elif width == 3:
        parts = np.frombuffer(data, np.uint8).reshape(-1, 3).astype(np.int32)
        values = ((parts[:, 0] | parts[:, 1] << 8 | parts[:, 2] << 16) << 8 >> 8).astype(np.float64)
    else:
        values = np.frombuffer(data, f"<i{width}").astype(np.float64)
    return values.reshape(-1, channels).mean(1) / 2.0 ** (8 * width - 1), rate
