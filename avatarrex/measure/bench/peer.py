"""Other people's programs that do what one of our stages does: run where they are installed, named where they are not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

from avatarrex.measure.bench.clock import Times, ratio
from avatarrex.measure.bench.metric import FASTER, SLOWER, Metric


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
        return None if entry is None else ratio(entry.times, self.best.times, self.cpu)

    def metrics(self) -> list[Metric]:
        """Everybody's time, its error beside it."""
        clock = "processor" if self.cpu else "wall"
        times = {entry.name: entry.times.cpu_ms if self.cpu else entry.times.ms for entry in self.entries}
        return [
            Metric(f"{self.case}.{entry.name}.ms", times[entry.name], "ms", error={**entry.error, "clock": clock})
            for entry in self.entries
        ]

    def comparison(self) -> list[Metric]:
        """Ours against everybody else."""
        return [
            Metric(
                f"peers.{self.case}.{entry.name}", ratio(entry.times, self.best.times, self.cpu), FASTER, "higher",
                {"ours": self.best.error, "theirs": entry.error},
            )
            for entry in self.entries
            if not entry.ours
        ]  # fmt: skip


@dataclass(frozen=True)
class Goal:
    """How far ours is to be ahead of a peer in every contest of a stage."""

    name: str
    """Of the metric."""
    peer: str
    unit: str
    """`FASTER` or `SLOWER`."""
    target: float

    def metric(self, contests: Sequence[Contest], by: str, error: dict[str, Any]) -> Metric | None:
        """The worst contest's ratio, those of all under `by` in its error; None where the peer took part in none."""
        slower = self.unit == SLOWER
        direction: Literal["lower", "higher"] = "lower" if slower else "higher"
        found = {one.case: ahead for one in contests if (ahead := one.advantage(self.peer)) is not None}
        found = {case: 1 / ahead if slower else ahead for case, ahead in found.items()}
        if not found:
            return None
        worst = (max if slower else min)(found.values())
        return Metric(self.name, worst, self.unit, direction, {by: found, **error}, self.target)


Peers = Mapping[str, tuple[tuple[str, ...], Callable[..., Callable[[], Any]]]]
"""By name the modules that it needs, and what sets it up for some work."""


def installed(peers: Peers, absent: dict[str, str], case: str, *work: Any) -> dict[str, Callable[[], Any]]:
    """The peers that are ready to run on the `work` of a case; why the others are not is noted in `absent`."""
    ready = {}
    for name, (modules, set_up) in peers.items():
        missing = [module for module in modules if find_spec(module) is None]
        if missing:
            absent[f"peers.{case}.{name}"] = f"not installed: {', '.join(missing)}"
        else:
            ready[name] = set_up(*work)
    return ready
