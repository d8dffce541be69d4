"""Coefficient vectors of Faceverse as the 52 coefficients (docs/signals.md). Letters: t frames.

    1       508 = id 150, exp 74,  tex 251, rot 3, gamma 27, trans 3
    2       486 = id 150, exp 52,  tex 251, rot 3, gamma 27, trans 3
    3       490 = id 150, exp 52,  tex 251, rot 3, gamma 27, trans 3, eye 4
    4       621 = id 156, exp 177, tex 251, gamma 27, rot 3, trans 3, eye 4

The 52 of versions 2 and 3 have Apple's names; a file of coefficients has no names, so Apple's order is taken, and said. Others need a
table (expression_map.py). Identity, texture and light belong to that face, rotation and path to its camera: none is applied.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.assets import numbers
from avatarrex.signals.expression_map import LARGEST, read_expression_map
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.sequence import SignalSequence, check_frames, stack

LAYOUTS: dict[int, tuple[str, slice]] = {
    508: ("1", slice(150, 224)), 486: ("2", slice(150, 202)), 490: ("3", slice(150, 202)), 621: ("4", slice(156, 333)),
}  # fmt: skip
"""By the length of a vector: the version, and where its expression is."""
BEYOND, MOST_BEYOND = 0.2, 0.05
"""How far outside 0 … 1 a coefficient is strange, and the share of strange ones that is warned of."""


def faceverse_motion(path: Path, vectors: np.ndarray, options: ImportOptions) -> ImportedMotion:
    """The motion of (t, n) vectors of `LAYOUTS`. Raises `InputError`."""
    check_frames(len(vectors), path, "frames")
    if not len(vectors):
        raise InputError(path, "", "at least one frame", vectors.shape)
    version, columns = LAYOUTS[vectors.shape[1]]
    values = numbers(vectors, path, "", LARGEST)[:, columns]
    expression, how, warnings = _expression(path, version, values, options)
    why = "chosen" if options.expressions else "a file of coefficients has no names"
    fps = options.fps or 30.0
    guesses = (
        Guess("file", f"Faceverse {version}", f"{len(vectors)} frames of {vectors.shape[1]} numbers"),
        Guess("expression", how, why, "expressions"),
        Guess("rate", f"{fps:g} frames a second", "chosen" if options.fps else "not in the file", "fps"),
    )
    notes = [*map(str, guesses), "identity, texture, light, rotation and path: not applied"]
    notes += [f"warning: {text}" for text in warnings]
    frames = stack(np.zeros((len(vectors), 55, 3)), np.zeros((len(vectors), 3)), expression)
    sequence = SignalSequence(frames, fps, path.name, tuple(notes))
    return ImportedMotion(sequence, guesses, tuple(warnings), options=options)


def _expression(
    path: Path, version: str, values: np.ndarray, options: ImportOptions
) -> tuple[np.ndarray, str, list[str]]:
    """(t, 52), how they follow, and warnings."""
    if options.expressions:
        table = read_expression_map(options.expressions, values.shape[1])
        return table(values), f"by {table.rows} rows of {Path(options.expressions).name}", []
    if values.shape[1] != 52:
        expected = f"--expressions FILE.csv with the 52 names by its {values.shape[1]} coefficients"
        raise InputError(path, f"Faceverse {version}", expected, "none")
    clipped = np.clip(values, 0, 1)
    strange = float((np.abs(values - clipped) > BEYOND).mean())
    text = f"{100 * strange:.0f} % of the coefficients are not within 0 … 1: of another order or version?"
    return clipped, "Apple's names in Apple's order", [text] if strange > MOST_BEYOND else []
