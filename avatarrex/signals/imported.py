"""A motion with what its reader guessed and warns of: what `motion check` prints and the studio's dialog shows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from avatarrex.errors import plain
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.sequence import SignalSequence


@dataclass(frozen=True)
class Guess:
    """One thing that a reader decided."""

    what: str
    value: str
    why: str = ""
    option: str = ""
    """The field of `ImportOptions` that decides it instead: a reader that heeds an option has a guess that names it."""

    def __str__(self) -> str:
        return plain(f"{self.what}: {self.value}" + (f" ({self.why})" if self.why else ""))


def feet(options: ImportOptions) -> Guess:
    """Whether feet that stand are kept where they stand."""
    if options.lock_feet:
        return Guess("feet", "stay where they stand", "chosen", "lock_feet")
    return Guess("feet", "as in the file", "", "lock_feet")


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The file's skeleton in our axes and metres, as it moves. Letters: t frames, j joints."""

    names: tuple[str, ...]
    parents: np.ndarray
    """(j,)."""
    places: np.ndarray
    """(t, j, 3)."""
    mapped: dict[str, str]
    """The file's joint of each of ours that it has."""


@dataclass(frozen=True, eq=False)
class ImportedMotion:
    """What a reader makes of a file."""

    sequence: SignalSequence
    guesses: tuple[Guess, ...] = ()
    warnings: tuple[str, ...] = ()
    """What looks wrong, each with its remedy."""
    skeleton: Skeleton | None = None
    """None where the file has none of its own: SMPL-X, faces, our JSON."""
    errors: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Median and largest angle in degrees between directions of the file and of ours, by part (fidelity.py)."""
    options: ImportOptions = field(default_factory=ImportOptions)
    """What was chosen instead of guessed."""
