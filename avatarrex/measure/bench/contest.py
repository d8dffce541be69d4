"""Timing contestants against each other: warm-up first, then turn by turn, so that a busy moment hits all alike.

Ratios are medians of the turns' own ratios. Wall-clock time is what a user waits; processor time of all threads is what
remains comparable where other programs run. Milliseconds. Other people's programs that do what one of our stages does run where
they are installed, and are named where they are not.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from statistics import median
from types import ModuleType
from typing import Any, Literal, ParamSpec, TypeVar

import torch

from avatarrex.measure.bench.report import FASTER, SLOWER, Metric

Given = ParamSpec("Given")
Result = TypeVar("Result")


@dataclass
class Times:
    """What the turns of one contestant took."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    """All threads of this process."""

    @property
    def ms(self) -> float:
        """Median wall-clock time."""
        return median(self.wall)

    @property
    def cpu_ms(self) -> float:
        """Median processor time."""
        return median(self.cpu)

    def add(self, more: Times) -> None:
        """Further turns."""
        self.wall += more.wall
        self.cpu += more.cpu

    def scaled(self, factor: float) -> Times:
        """Of `factor` times the work, where cost is proportional to it."""
        return Times([factor * t for t in self.wall], [factor * t for t in self.cpu])


def timed(work: Callable[Given, Result], *arguments: Given.args, **options: Given.kwargs) -> tuple[Result, Times]:
    """What a call gives, and the one turn that it took."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(*arguments, **options)
    return result, Times([1e3 * (time.perf_counter() - wall)], [1e3 * (time.process_time() - cpu)])


def interleaved(contestants: Mapping[str, Callable[[], object]], repeats: int, warm: bool = True) -> dict[str, Times]:
    """Each contestant `repeats` times, in turns; before that once without counting."""
    found = {name: Times() for name in contestants}
    for turn in range(-1 if warm else 0, repeats):
        for name, work in contestants.items():
            _, took = timed(work)
            if turn >= 0:
                found[name].add(took)
    return found


def ratio(above: Times, below: Times, cpu: bool = False) -> float:
    """How many times as long `above` took: median over the turns both made."""
    pairs = zip(above.cpu, below.cpu) if cpu else zip(above.wall, below.wall)
    return median(a / b for a, b in pairs)


@contextmanager
def one_core() -> Iterator[None]:
    """This thread, and every thread that it starts meanwhile, on one core; torch with one thread."""
    threads = torch.get_num_threads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    torch.set_num_threads(1)
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
        torch.set_num_threads(threads)


@contextmanager
def spent(module: ModuleType, name: str) -> Iterator[Times]:
    """How long the calls of `module.name` take inside the block: one entry a call."""
    whole: Any = getattr(module, name)
    times = Times()

    def measured(*arguments: Any, **options: Any) -> Any:
        result, took = timed(whole, *arguments, **options)
        times.add(took)
        return result

    setattr(module, name, measured)
    try:
        yield times
    finally:
        setattr(module, name, whole)


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

    @property
    def named(self) -> dict[str, Contestant]:
        """Who took part, by name."""
        return {entry.name: entry for entry in self.entries}

    def advantage(self, name: str) -> float:
        """How many times as long `name` takes as ours."""
        return ratio(self.named[name].times, self.best.times, self.cpu)

    def metrics(self) -> list[Metric]:
        """Everybody's time, its error beside it."""
        clock = "processor" if self.cpu else "wall"
        return [
            Metric(
                f"{self.case}.{entry.name}.ms", entry.times.cpu_ms if self.cpu else entry.times.ms, "ms",
                error={**entry.error, "clock": clock},
            )
            for entry in self.entries
        ]  # fmt: skip

    def comparison(self) -> list[Metric]:
        """Ours against everybody else."""
        return [
            Metric(
                f"peers.{self.case}.{entry.name}", self.advantage(entry.name), FASTER, "higher",
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

    def metrics(self, contests: Sequence[Contest], by: str, **error: Any) -> list[Metric]:
        """The worst contest's ratio, those of all under `by` in its error; none where the peer took part in none."""
        slower = self.unit == SLOWER
        found = {one.case: one.advantage(self.peer) for one in contests if self.peer in one.named}
        found = {case: 1 / ahead if slower else ahead for case, ahead in found.items()}
        worst = (max if slower else min)(found.values(), default=None)
        direction: Literal["lower", "higher"] = "lower" if slower else "higher"
        measured = {by: found, **error}
        return [] if worst is None else [Metric(self.name, worst, self.unit, direction, measured, self.target)]


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
