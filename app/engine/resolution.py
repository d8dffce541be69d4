"""How many pixels the viewport renders: few while something moves, more when it stops, all at rest.

Three states, moving → still → full (after 0.2 s). The sizes of the first two follow from the measured cost of a pixel
and a time budget, change only when they are off by more than a fifth, and have a floor. Times in seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

FULL_AFTER = 0.2
"""Rest before the full raster is rendered."""
HYSTERESIS = 0.2
"""A size is kept while the wanted one is within this share of it."""
FLOOR_PIXELS = 128
"""Pixels of the smaller side below which a face is no longer one."""


class Activity(Enum):
    """What the user is doing."""

    MOVING = "moving"
    STILL = "still"
    FULL = "full"


PIXEL_SECONDS = {Activity.MOVING: 1 / 12, Activity.STILL: 0.3}
"""Seconds that the pixels of a frame may take."""


@dataclass
class Resolution:
    """Chooses the raster of each frame from what the last ones cost."""

    state: Activity = Activity.FULL
    seconds_per_pixel: float = 1e-6
    """Of the level in use."""
    _level: str = ""
    _others: dict[str, float] = field(default_factory=dict)
    _changed_at: float = -math.inf
    _scale: float = 1.0

    def at(self, level: str) -> None:
        """Go on with what a pixel cost at `level`; where that is not known yet, with the present figure."""
        self._others[self._level] = self.seconds_per_pixel
        self._level, self.seconds_per_pixel = level, self._others.get(level, self.seconds_per_pixel)

    def tick(self, now: float, changed: bool) -> Activity:
        """The state at `now`, given whether the picture's inputs changed since the last tick."""
        if changed:
            self._changed_at = now
            self.state = Activity.MOVING
        elif now - self._changed_at >= FULL_AFTER:
            self.state = Activity.FULL
        elif self.state is Activity.MOVING:
            self.state = Activity.STILL
        return self.state

    def wait(self, now: float) -> float | None:
        """Seconds until the state will change by itself; None at rest."""
        return None if self.state is Activity.FULL else max(FULL_AFTER - (now - self._changed_at), 0.0)

    def measured(self, now: float, pixels: int, seconds: float) -> None:
        """What the pixel-dependent stages of a frame cost, smoothed since one frame is a noisy measure.

        The rest begins at `now`, when the frame is there to be seen: a slow frame must not count as rest.
        """
        if self.state is Activity.MOVING:
            self._changed_at = now
        if pixels and seconds > 0:
            self.seconds_per_pixel = 0.5 * self.seconds_per_pixel + 0.5 * seconds / pixels

    def size(self, full: tuple[int, int]) -> tuple[int, int]:
        """Width and height for a view whose full raster is `full`; even, never larger than `full`."""
        if self.state is Activity.FULL:
            return full
        width, height = full
        affordable = PIXEL_SECONDS[self.state] / self.seconds_per_pixel
        lowest = min(FLOOR_PIXELS / min(full), 1.0)
        wanted = min(max(math.sqrt(affordable / (width * height)), lowest), 1.0)
        if self.state is Activity.STILL:
            return _scaled(full, max(wanted, self._scale))
        if not (1 - HYSTERESIS) * self._scale <= wanted <= (1 + HYSTERESIS) * self._scale:
            self._scale = wanted
        self._scale = min(max(self._scale, lowest), 1.0)
        return _scaled(full, self._scale)


def _scaled(full: tuple[int, int], scale: float) -> tuple[int, int]:
    if scale >= 1:
        return full
    width, height = (max(16, 2 * round(side * scale / 2)) for side in full)
    return min(width, full[0]), min(height, full[1])
