"""The part of time that the Timeline shows: seconds to points and back, the ticks of its ruler."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0)
"""Seconds between labels."""
FRAME_STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 50_000, 100_000)
LABEL = 52.0
"""Points between labels, at least."""
MARGIN = 8.0
"""Points before the first frame and after the last."""
NEAREST, FARTHEST = 0.2, 7200.0
"""Seconds that are shown at least and at most."""


@dataclass(frozen=True)
class Timescale:
    """From `start` on `seconds` are shown over `width` points, which begin at `left`."""

    left: float
    width: float
    start: float
    seconds: float

    @classmethod
    def of_all(cls, left: float, width: float, seconds: float) -> Timescale:
        """All of a timeline."""
        margin = seconds * MARGIN / max(width - 2 * MARGIN, 1.0)
        return cls(left, width, -margin, seconds + 2 * margin)

    def x(self, seconds: float) -> float:
        """Points."""
        return self.left + (seconds - self.start) / self.seconds * self.width

    def time(self, x: float) -> float:
        """Seconds."""
        return self.start + (x - self.left) / self.width * self.seconds

    @property
    def per_second(self) -> float:
        """Points of a second."""
        return self.width / self.seconds

    def zoomed(self, factor: float, about: float) -> Timescale:
        """`factor` times the seconds, those at `about` (points) stay where they are."""
        seconds = min(max(self.seconds * factor, NEAREST), FARTHEST)
        middle = self.time(about)
        return replace(self, start=middle - (middle - self.start) * seconds / self.seconds, seconds=seconds)

    def panned(self, points: float) -> Timescale:
        """Moved to the left by some points."""
        return replace(self, start=self.start + points / self.per_second)

    def ticks(self, fps: float, in_frames: bool) -> Iterator[tuple[float, str]]:
        """Times of the ruler's ticks and their labels, empty for those between."""
        if in_frames:
            count = next((n for n in FRAME_STEPS if n / fps * self.per_second >= LABEL), FRAME_STEPS[-1])
            step, parts = count / fps, [n for n in (10, 5, 2) if count % n == 0]
        else:
            step, parts = next((each for each in STEPS if each * self.per_second >= LABEL), STEPS[-1]), [10, 5, 2]
        between = next((n for n in parts if step / n * self.per_second >= 6), 1)
        first = max(math.ceil(self.start / step - 1e-9), 0)
        for k in range(first * between, int((self.start + self.seconds) / step * between) + 1):
            time = k * step / between
            if k % between:
                yield time, ""
            else:
                yield time, f"{round(time * fps)}" if in_frames else clock(time)


def clock(seconds: float) -> str:
    """`2.5 s`, `1:05`."""
    if seconds >= 60:
        return f"{int(seconds // 60)}:{seconds % 60:02.0f}"
    return f"{seconds:.3g} s"
