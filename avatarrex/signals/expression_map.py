"""A table from another face's coefficients to the 52: ψ = M c + b, clipped to 0 … 1 (docs/signals.md).

A CSV file that a person edits: a head `name,0,1,…` with one column for each of the other face's coefficients and, where there is
one, a column `bias`; a row for each of the 52 that follows them, by its name. Those without a row stay at rest. A column `explained` is
a remark: how much of the name's motion the other face can show, 0 to 1 (`models matrix` writes it).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.gate import read_lines, write_text
from avatarrex.signals.joints import EXPRESSION_NAMES

LARGEST = 1e6
"""Of a coefficient and of a number of the table."""
REMARK = "explained"
"""The column that is not read."""
ORDERED = "name (ordered)"
"""Head of the first column of tables for a basis like FLAME's, of which motions may have the first coefficients alone."""


@dataclass(frozen=True, eq=False)
class ExpressionMap:
    """M and b."""

    matrix: np.ndarray
    """(52, k)."""
    bias: np.ndarray
    """(52,)."""
    rows: int
    """Of the 52 that the file has."""
    columns: int
    """Of coefficients that the file has: k or more, the first k are used."""

    def __call__(self, coefficients: np.ndarray) -> np.ndarray:
        """(t, 52) of (t, k), numbers up to `LARGEST`."""
        return np.asarray(np.clip(coefficients @ self.matrix.T + self.bias, 0, 1))


def read_expression_map(path: str | Path, width: int, wider: bool = False) -> ExpressionMap:
    """The table of `width` coefficients in a file, or, `wider`, of more where it says `ORDERED`: its first ones are used.

    Raises `InputError` naming line or row and column.
    """
    reader = csv.reader(read_lines(path, "a CSV file"))
    try:
        rows = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise InputError(path, f"line {reader.line_num}", "a readable CSV file", error) from None
    head = [word.strip() for word in rows[0][1]] if rows else []
    there = len(head) - 1 - sum(head.count(word) for word in ("bias", REMARK))
    total = max(width, there) if wider and head[:1] == [ORDERED] else width
    known = {"bias", REMARK, *map(str, range(total))}
    named = head[:1] in (["name"], [ORDERED])
    if not named or len(set(head)) != len(head) or not set(head[1:]) <= known or there != total:
        found = f"{len(head) - 1} columns" if named else ",".join(head)[:60] or "an empty file"
        raise InputError(path, "line 1", f"name,0,…,{width - 1} with or without bias", found)
    matrix, bias, seen = np.zeros((52, total)), np.zeros(52), set[str]()
    for number, row in rows[1:]:
        name = row[0].strip()
        if name not in EXPRESSION_NAMES or name in seen:
            raise InputError(path, f"line {number}", "one of the 52 names, each once", name)
        if len(row) != len(head):
            raise InputError(path, name, f"{len(head) - 1} numbers", len(row) - 1)
        seen.add(name)
        for column, word in zip(head[1:], row[1:]):
            if column == REMARK:
                continue
            value, ours = _number(path, f"{name}: {column}", word), EXPRESSION_NAMES.index(name)
            if column == "bias":
                bias[ours] = value
            else:
                matrix[ours, int(column)] = value
    if not matrix.any():
        raise InputError(path, "", "at least one number that is not 0", "none")
    return ExpressionMap(matrix[:, :width], bias, len(seen), total)


def write_expression_map(path: str | Path, matrix: np.ndarray, explained: np.ndarray, ordered: bool = False) -> None:
    """M (52, k) as `read_expression_map` reads it, and the shares (52,) as a remark; whether coefficients are `ORDERED`.

    Raises `InputError` where it cannot be written.
    """
    rows = [",".join([name, f"{share:.2f}", *(f"{value:.4g}" for value in row)])
            for name, share, row in zip(EXPRESSION_NAMES, explained, matrix)]  # fmt: skip
    write_text(
        path,
        "\n".join([",".join([ORDERED if ordered else "name", REMARK, *map(str, range(matrix.shape[1]))]), *rows])
        + "\n",
    )


def _number(path: str | Path, place: str, word: str) -> float:
    try:
        value = float(word or 0)
    except ValueError:
        value = np.nan
    if not abs(value) <= LARGEST:
        raise InputError(path, place, f"a number up to {LARGEST:g}", word)
    return value
