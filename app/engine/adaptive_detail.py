"""How finely the surface is drawn while it moves: as finely as `RATE` pictures a second allow.

A frame of the interface in which a picture was drawn takes until the next one begins; a motion of few frames a second is not slow
by that. Some slow frames make the next pictures coarser, many quick ones finer. What is remembered when it rests is where the next
movement begins. Times in seconds.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

RATE, QUICK = 30.0, 45.0
"""Pictures a second that are wanted, and with which there is room for finer ones. The step with most more work (one sample to four where
a picture fills the screen) takes 1.6 times as long: after it there are 28 still."""
LATE = 1.05
"""Times what a frame may take, before it is slow: a screen of 30 Hz is not."""
FEW, MANY, MOST = 4, 30, 600
"""Frames that make pictures coarser; and finer, after the first time that they became coarser, twice as many after each further one, at most:
what is too slow when it is finer does not flicker."""


class Detail(NamedTuple):
    """How finely a picture is drawn."""

    samples: int
    """Of a pixel: 4, 2 or 1."""
    share: float
    """Of the pixels along each side."""

    def size(self, full: tuple[int, int]) -> tuple[int, int]:
        """The raster of a picture that is `full` (width, height) at its finest."""
        width, height = (max(16, round(self.share * side)) for side in full)
        return width, height


DETAILS = Detail(4, 1.0), Detail(2, 1.0), Detail(1, 1.0), Detail(1, 0.75)
"""From fine to coarse. Mesa's llvmpipe takes as long for two samples as for four."""
FINEST = DETAILS[0]


class AdaptiveDetail:
    """The detail of moving pictures, by what the frames took in which they were drawn."""

    def __init__(self) -> None:
        self.detail = FINEST
        """Of the next picture while something moves."""
        self.limit = math.inf
        """Frames a second that the interface draws at most; to wait for the next is not slow."""
        self._began: float | None = None
        """The last frame, where a moving picture was drawn in it."""
        self._took: deque[float] = deque(maxlen=FEW)
        self._quick, self._wanted = 0, MANY // 2

    def begin(self, now: float) -> None:
        """A frame of the interface begins."""
        if self._began is not None:
            self._take(now - self._began)
        self._began = None

    def drawn(self, now: float) -> None:
        """In the frame that began at `now` a picture is drawn of something that moves."""
        self._began = now

    def _take(self, seconds: float) -> None:
        """What a frame took with a picture in it."""
        self._took.append(seconds)
        self._quick = self._quick + 1 if seconds < max(1 / QUICK, LATE / self.limit) else 0
        if len(self._took) == FEW and median(self._took) > LATE / min(RATE, self.limit) and self.detail != DETAILS[-1]:
            self._wanted = min(2 * self._wanted, MOST)
            self._change(1)
        elif self._quick >= self._wanted and self.detail != FINEST:
            self._change(-1)

    def _change(self, steps: int) -> None:
        self.detail = DETAILS[DETAILS.index(self.detail) + steps]
        self._took.clear()
        self._quick = 0


def finer(detail: Detail) -> Detail:
    """The next finer one, for what has stopped; the finest itself."""
    return DETAILS[max(DETAILS.index(detail) - 1, 0)]
