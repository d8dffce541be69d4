"""Unnamed expression coefficients by the 52 names: a table that can be edited, `faceverse_expressions.csv` beside a Faceverse file.

    directions of the 52 (v, 3, 52) = directions of the file (v, 3, c) · matrix (c, 52)

The first line has the 52 names, in any order, a line of numbers follows for each of the file's coefficients: a column says what a name's
coefficient 1 sets. Lines that begin with # are remarks. `expression_fit` makes a first one. Letters: v vertices, c coefficients. Metres.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.gate import read_text, write_text
from avatarrex.signals.joints import EXPRESSION_NAMES

FILE = "faceverse_expressions.csv"
LARGEST = 1e4
"""Of a coefficient."""


def read_matrix(path: str | Path, coefficients: int | None = None) -> np.ndarray:
    """(c, 52), columns in our order, of so many coefficients where it is said. Raises `InputError` naming the line."""
    text = read_text(path, "a table of numbers")
    try:
        lines = [row for row in enumerate(csv.reader(text.splitlines()), 1) if any(map(str.strip, row[1]))]
    except csv.Error as error:
        raise InputError(path, "", "a readable CSV file", error) from None
    rows = [row for row in lines if not row[1][0].lstrip().startswith("#")]
    names = [name.strip() for name in rows[0][1]] if rows else []
    if sorted(names) != sorted(EXPRESSION_NAMES):
        wrong = next((name for name in names if name not in EXPRESSION_NAMES), f"{len(set(names))} names")
        raise InputError(path, "line 1", "the 52 names, each once", wrong)
    if len(rows) - 1 != (coefficients or max(1, len(rows) - 1)):
        raise InputError(
            path, "", f"{coefficients or 'some'} lines of numbers, one a coefficient of the face", len(rows) - 1
        )
    values = np.array([_numbers(row, line, path) for line, row in rows[1:]])
    return values[:, [names.index(name) for name in EXPRESSION_NAMES]]


def write_matrix(path: str | Path, matrix: np.ndarray, explained: np.ndarray | None = None) -> None:
    """As `read_matrix` reads it; `explained` (52,), the share of each name's motion, is a remark under the names. Raises `InputError`
    where it cannot be written."""
    remarks = [] if explained is None else [",".join(f"# {share:.0%}" for share in explained)]
    lines = [",".join(EXPRESSION_NAMES), *remarks, *(",".join(f"{value:.4g}" for value in row) for row in matrix)]
    write_text(path, "\n".join(lines) + "\n")


def _numbers(row: list[str], line: int, path: str | Path) -> list[float]:
    if len(row) != len(EXPRESSION_NAMES):
        raise InputError(path, f"line {line}", f"{len(EXPRESSION_NAMES)} numbers", len(row))
    try:
        values = [float(cell) for cell in row]
    except ValueError as error:
        raise InputError(path, f"line {line}", "numbers", error) from None
    if not all(abs(value) <= LARGEST for value in values):
        raise InputError(path, f"line {line}", f"finite numbers up to {LARGEST:g}", max(values, key=abs))
    return values
