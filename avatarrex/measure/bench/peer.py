"""Other people's programs that do what one of our stages does: run where they are installed, named where they are not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from avatarrex.measure.bench.clock import Times, ratio
from avatarrex.measure.bench.metric import FASTER, Metric


@dataclass(frozen=True)
class Contestant:
    """One way to do a piece of work: how long it takes and how wrong it is."""

    name: str
    times: Times
    error: dict[str, Any]
    """Figures by name with their unit at the end, e.g. `max_error_m`; notes as text."""
    ours: bool = False


@dataclass(frozen=True)
class Contest:
    """Contestants on one piece of work, measured in turns. The first of ours is what the others are compared with."""

    case: str
    """`stage.case`."""
    entries: tuple[Contestant, ...]
    cpu: bool
    """Compare processor time (one core, or a renderer in software) rather than the clock."""

    @property
    def best(self) -> Contestant:
        """Ours."""
        return next(entry for entry in self.entries if entry.ours)

    def named(self, name: str) -> Contestant | None:
        """None where it did not take part."""
        return next((entry for entry in self.entries if entry.name == name), None)

    def advantage(self, name: str) -> float | None:
        """How many times as long `name` takes as ours; None where it did not take part."""
        entry = self.named(name)
        return None if entry is None else self.against(entry)

    def against(self, entry: Contestant) -> float:
        """How many times as long `entry` takes as ours."""
        return ratio(entry.times, self.best.times, self.cpu)

    def metrics(self) -> list[Metric]:
        """Everybody's time, its error beside it."""
        clock = "processor" if self.cpu else "wall"
        return [
            Metric(
                f"{self.case}.{entry.name}.ms",
                entry.times.cpu_ms if self.cpu else entry.times.ms,
                "ms",
                error={**entry.error, "clock": clock},
            )
            for entry in self.entries
        ]

    def comparison(self) -> list[Metric]:
        """Ours against everybody else."""
        mine = self.best
        return [
            Metric(
                f"peers.{self.case}.{entry.name}",
                self.against(entry),
                FASTER,
                "higher",
                error={"ours": mine.error, "theirs": entry.error},
            )
            for entry in self.entries
            if not entry.ours
        ]


def installed(
    peers: Mapping[str, tuple[str | tuple[str, ...], Callable[..., Callable[[], Any]]]], *work: Any
) -> tuple[dict[str, Callable[[], Any]], dict[str, str]]:
    """What is ready to run on `work`, and why the rest is not; `peers`: the modules that each needs, and what sets it up."""
    ready, absent = {}, {}
    for name, (needed, set_up) in peers.items():
        modules = (needed,) if isinstance(needed, str) else needed
        missing = [module for module in modules if find_spec(module) is None]
        if missing:
            absent[name] = f"not installed: {', '.join(missing)}"
            continue
        ready[name] = set_up(*work)
    return ready, absent
