"""One measured figure: its error beside it, and what it should be (targets: docs/bench.md).

A metric's unit says how a gate may judge it: times depend on the machine, ratios were taken within one run, everything
else (errors, counts, sizes) is what it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

TIMES = ("ms", "fps")
FASTER, SLOWER = "× as fast", "× the time"
RATIOS = (FASTER, SLOWER)
TOLERANCE = 0.25
"""Relative. Ratios of two times in one run drift by this much on a shared 2-core machine."""


@dataclass(frozen=True)
class Metric:
    """A figure."""

    name: str
    """`stage.what`, or `stage.case.contestant.ms` where several do the same work."""
    value: float
    unit: str
    direction: Literal["lower", "higher"] = "lower"
    """Which way is better."""
    error: dict[str, Any] | None = None
    """The error that this time or ratio comes with, and what else is needed to read it."""
    target: float | None = None
    tolerance: float = TOLERANCE
    """Share by which a later value may be worse."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise ArithmeticError(f"{self.name} is {self.value}")

    @property
    def kind(self) -> Literal["time", "ratio", "error"]:
        """What a gate may do with it."""
        return "time" if self.unit in TIMES else "ratio" if self.unit in RATIOS else "error"

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        return self.value <= self.target if self.direction == "lower" else self.value >= self.target
