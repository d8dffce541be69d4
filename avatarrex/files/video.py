"""Videos on disk, `.mp4` and `.webm`, with sound or without, written under a temporary name and then renamed.

Letters: h w image rows and columns, s samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from avatarrex.errors import InputError
from avatarrex.files.gate import written

Append = Callable[[np.ndarray], None]
Sound = Float[np.ndarray, " s"]
"""`SOUND_RATE` samples a second from the first picture on, −1 to 1."""
SOUND_RATE = 48_000
VIDEOS = (".mp4", ".webm")
"""H.264 and AAC, without alpha; VP9 with alpha, and Opus."""


def video_writer(
    path: str | Path, width: int, height: int, fps: float, sound: Sound | None = None
) -> AbstractContextManager[Append]:
    """A block's `append(pixels)` adds a frame, (height, width, 4) straight-alpha bytes, to a video with even sides: one of `VIDEOS`.

    `sound` is cut where the pictures end. The file is there once the block ends well. Needs the `video` extra (PyAV). Raises `InputError`.
    """
    if width % 2 or height % 2:
        raise InputError(path, "size", "even sides for a video", f"{width}x{height}")
    if not 0.001 <= fps <= 1000:
        raise InputError(path, "fps", "a number from 0.001 to 1000", fps)
    try:
        import av
    except ImportError:
        raise InputError(path, "", "the 'video' extra: pip install 'avatarrex-studio[video]'", "no PyAV") from None
    return _video(av, Path(path), (width, height), Fraction(fps).limit_denominator(1001), sound)


@contextmanager
def _video(av: Any, path: Path, size: tuple[int, int], rate: Fraction, sound: Sound | None) -> Iterator[Append]:
    clear = path.suffix.lower() == ".webm"
    with written(path) as temporary, av.open(str(temporary), "w", format="webm" if clear else "mp4") as container:
        stream = container.add_stream("libvpx-vp9" if clear else "libx264", rate=rate)
        (stream.width, stream.height), stream.pix_fmt = size, "yuva420p" if clear else "yuv420p"
        quick = {"crf": "18", "b": "0", "deadline": "good", "cpu-used": "5", "row-mt": "1"}
        stream.options = quick if clear else {"crf": "16", "preset": "medium"}
        channels, form = (4, "rgba") if clear else (3, "rgb24")
        voice = None if sound is None else _Voice(av, container, "libopus" if clear else "aac", sound)
        count = 0

        def append(pixels: UInt8[np.ndarray, "h w 4"]) -> None:
            nonlocal count
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels[..., :channels]), format=form)
            container.mux(stream.encode(frame))
            count += 1
            if voice:
                voice.go_on(count / rate)

        yield append
        container.mux(stream.encode())
        if voice:
            voice.end()


class _Voice:
    """The sound beside the pictures of a container."""

    def __init__(self, av: Any, container: Any, codec: str, sound: Sound) -> None:
        self._av, self._container, self._sound, self._done = av, container, sound.astype(np.float32), 0
        self._stream = container.add_stream(codec, rate=SOUND_RATE, layout="mono")

    def go_on(self, seconds: Fraction) -> None:
        """Up to a time."""
        end = min(int(seconds * SOUND_RATE), len(self._sound))
        if end == self._done:
            return
        frame = self._av.AudioFrame.from_ndarray(self._sound[None, self._done : end], format="fltp", layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = SOUND_RATE, self._done, Fraction(1, SOUND_RATE)
        self._container.mux(self._stream.encode(frame))
        self._done = end

    def end(self) -> None:
        """What the encoder still has."""
        self._container.mux(self._stream.encode())
