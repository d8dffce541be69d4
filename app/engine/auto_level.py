"""`auto`: the most exact level that the time at hand allows, from what this session's own pictures cost.

While something moves the level only falls, to the first whose pictures keep the budget; at rest it climbs as far as the
cost of one picture allows, and tries what it has no figure for, one level at a time. A cost is a fixed part (templates,
volume) and a part per pixel (point map, shading): the raster changes with the motion. Milliseconds. No clock in here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from avatarrex_studio.engine.resolution import Activity

from avatarrex.levels import DEFERRED_LEVELS

ORDER = tuple(name for name in DEFERRED_LEVELS if name != "paper")
"""From the quickest to the most exact; `paper` is slower and less exact than all of them."""
PICTURE_MS = {Activity.MOVING: 100.0, Activity.STILL: 500.0, Activity.FULL: 2000.0}
"""Milliseconds that a picture may take: of a drag, when the hand stops, and of the one that stays."""
SHARE = 0.3
"""Weight of the newest picture in the average."""
MEMORY = 200
"""Pictures after which a figure is forgotten, so that a level that was too slow once is tried again."""


class Change(Enum):
    """What a picture was made for."""

    POSE = "pose"
    VIEW = "view"
    LEVEL = "level"


@dataclass
class Cost:
    """Averages of one level and kind of change."""

    fixed: float
    per_pixel: float
    age: int = 0
    """Pictures since the last one that counted."""

    def of(self, pixels: int) -> float:
        """Milliseconds of a picture of so many pixels."""
        return self.fixed + self.per_pixel * pixels


@dataclass
class AutoLevel:
    """What the levels cost, and the choice that follows."""

    _costs: dict[tuple[str, Change], Cost] = field(default_factory=dict)
    _drawn: set[str] = field(default_factory=set)

    def measured(self, level: str, change: Change, pixels: int, fixed: float, growing: float) -> None:
        """A picture took `fixed` ms, and `growing` ms that are due to its pixels.

        A level's first picture of a session does not count: its shaders are compiled in it.
        """
        if level not in self._drawn:
            self._drawn.add(level)
            return
        for key, cost in list(self._costs.items()):
            cost.age += 1
            if cost.age > MEMORY:
                del self._costs[key]
        per_pixel = growing / max(pixels, 1)
        old = self._costs.get((level, change), Cost(fixed, per_pixel))
        self._costs[level, change] = Cost(
            old.fixed + SHARE * (fixed - old.fixed), old.per_pixel + SHARE * (per_pixel - old.per_pixel)
        )

    def cost(self, level: str, change: Change, pixels: int) -> float | None:
        """Milliseconds that such a picture is expected to take; None where there is no figure."""
        known = self._costs.get((level, change))
        return known.of(pixels) if known else None

    def choose(self, current: str, change: Change, motion: Activity, pixels: int) -> str:
        """The level of the next picture of `pixels`, after one at `current`."""
        if current not in ORDER:
            current = ORDER[0]
        rank, budget = ORDER.index(current), PICTURE_MS[motion]
        if motion is Activity.MOVING:
            for name in reversed(ORDER[: rank + 1]):
                cost = self.cost(name, change, pixels)
                if cost is None or cost <= budget:
                    return name
            return ORDER[0]
        for name in reversed(ORDER[rank + 1 :]):
            cost = self.cost(name, Change.LEVEL, pixels)
            if cost is not None and cost <= budget:
                return name
        above = ORDER[rank + 1 : rank + 2]
        untried = motion is Activity.FULL and above and self.cost(above[0], Change.LEVEL, pixels) is None
        return above[0] if untried else current
