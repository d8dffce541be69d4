"""Timing contestants against each other: warm-up first, then turn by turn, so that a busy moment hits all alike.

Ratios are medians of the turns' own ratios. Wall-clock time is what a user waits; processor time of all threads is what
remains comparable where other programs run. Milliseconds.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

import torch

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
