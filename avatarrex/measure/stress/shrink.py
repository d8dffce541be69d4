"""Making a failing case small: numbers to zero, group by group, magnitudes halved, rows left out, while it still fails.

What remains is what the failure needs; a person reads it, and it runs in a test.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from avatarrex.measure.stress.case import Inputs, Kind, examine
from avatarrex.measure.stress.findings import Finding

SECONDS = 120.0
"""How long one failure is shrunk."""
HALVINGS = 3
"""Rounds in which magnitudes are halved: smaller is not simpler for ever."""


@dataclass(frozen=True)
class Shrunk:
    """The smallest case that was found, what it fails with, and how many were tried."""

    inputs: Inputs
    finding: Finding
    tried: int


def shrink(kind: Kind, inputs: Inputs, failure: Finding) -> Shrunk:
    """The smallest case that fails the same check as `inputs` does."""
    repeated = failure.check == "same bits again"
    best, tried, end = Shrunk(inputs, failure, 0), 0, time.monotonic() + SECONDS
    for simpler in (_without, _rowwise, *[_halved] * HALVINGS, _fewer):
        progress = True
        while progress and time.monotonic() < end:
            progress = False
            for candidate in simpler(kind, best.inputs):
                tried += 1
                same = [f for f in examine(kind, candidate, repeated) if f.check == failure.check and f.failed]
                if same and _alike(failure, same[0]):
                    best, progress = Shrunk(candidate, same[0], tried), simpler is not _halved
                    break
                if time.monotonic() > end:
                    break
    return Shrunk(best.inputs, best.finding, tried)


def _alike(one: Finding, other: Finding) -> bool:
    """Of an exception, that it is the same kind: a case must not shrink into another failure."""
    return one.check != "raises nothing" or one.note.split(":")[0] == other.note.split(":")[0]


def _without(kind: Kind, inputs: Inputs) -> Iterator[Inputs]:
    for name in kind.simpler:
        if inputs[name].any():
            yield {**inputs, name: np.zeros_like(inputs[name])}


def _rowwise(kind: Kind, inputs: Inputs) -> Iterator[Inputs]:
    """Halves of the rows that are not zero yet, then single ones."""
    for name in kind.simpler:
        rows = np.flatnonzero(inputs[name].reshape(len(inputs[name]), -1).any(1))
        for part in _parts(rows):
            value = inputs[name].copy()
            value[part] = 0
            yield {**inputs, name: value}


def _halved(kind: Kind, inputs: Inputs) -> Iterator[Inputs]:
    if kind.simpler:
        yield {**inputs, **{name: inputs[name] / 2 for name in kind.simpler}}


def _fewer(kind: Kind, inputs: Inputs) -> Iterator[Inputs]:
    for name in kind.fewer:
        rows = np.arange(len(inputs[name]))
        for part in _parts(rows):
            if len(part) < len(rows):
                yield {**inputs, name: np.delete(inputs[name], part, 0)}


def _parts(rows: np.ndarray) -> Iterator[np.ndarray]:
    """All of them in halves, quarters, eighths, … down to single rows."""
    pieces = 2
    while len(rows):
        yield from np.array_split(rows, min(pieces, len(rows)))
        if pieces >= len(rows):
            return
        pieces *= 2
