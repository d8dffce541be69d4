"""A run of many cases in several processes, each on one thread: which cases, in which order, and what they found.

A case is made from the run's seed, its kind and its number alone, so that any of them can be made again anywhere.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch

from avatarrex.measure.stress import agreement, meshes, picture, points, poison, solids
from avatarrex.measure.stress.case import Inputs, Kind, examine
from avatarrex.measure.stress.findings import Finding

KINDS: dict[str, Kind] = {
    module.KIND.name: module.KIND for module in (points, picture, meshes, solids, agreement, poison)
}
PICTURE_EVERY = 20
"""One driving signal in so many becomes a whole frame; the others go through templates, nodes and fields."""
BESIDE = {"mesh": 20, "rays": 20, "agreement": 50, "poison": 50}
"""For so many driving signals one case of these kinds comes on top; poison at least once at every border."""
BATCH = 4
"""Cases that a process takes at a time."""


@dataclass(frozen=True)
class Outcome:
    """What one case found."""

    kind: str
    number: int
    findings: list[Finding]
    cpu_seconds: float

    @property
    def failures(self) -> list[Finding]:
        """Checks that failed."""
        return [finding for finding in self.findings if finding.failed]


def plan(count: int) -> list[tuple[str, int]]:
    """Kind and number of every case for `count` driving signals, mixed so that an early end has seen all kinds."""
    cases: list[tuple[str, int]] = []
    for k in range(count):
        block, place = divmod(k, PICTURE_EVERY)
        last = place == PICTURE_EVERY - 1
        cases.append(("picture", block) if last else ("points", k - block))
        cases += [(kind, k // every) for kind, every in BESIDE.items() if k % every == 0]
    done = sum(kind == "poison" for kind, _ in cases)
    return cases + [("poison", k) for k in range(done, len(poison.BORDERS))]


def make(kind: str, number: int, seed: int) -> Inputs:
    """The inputs of a case."""
    place = list(KINDS).index(kind)
    return KINDS[kind].draw(np.random.default_rng([seed, place, number]), number)


def run(cases: list[tuple[str, int]], seed: int, processes: int) -> Generator[Outcome, None, None]:
    """The outcome of every case, in order; with one process, in this one. Stops its processes when it is closed."""
    work = [(kind, number, seed) for kind, number in cases]
    if processes == 1:
        yield from map(outcome, work)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, initializer=_start) as pool:
        try:
            yield from pool.map(outcome, work, chunksize=BATCH)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def outcome(case: tuple[str, int, int]) -> Outcome:
    """Make and examine one case."""
    kind, number, seed = case
    start = time.process_time()
    inputs = make(kind, number, seed)
    findings = examine(KINDS[kind], inputs, number % KINDS[kind].repeat == 0)
    return Outcome(kind, number, findings, time.process_time() - start)


def _start() -> None:
    """Of a process: one thread, and Ctrl+C is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
