"""Unnamed expression coefficients by the 52 names: a table that can be edited, `faceverse_expressions.csv` beside a Faceverse file.

    directions of the 52 (v, 3, 52) = directions of the file (v, 3, c) · matrix (c, 52)

The first line has the 52 names, in any order, a line of numbers follows for each of the file's coefficients: a column says what a name's
coefficient 1 sets. `guessed` makes a first one from the default person's face. Letters: v vertices, c coefficients. Metres.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.gate import read_text, write_text
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.model import TemplateModel

FILE = "faceverse_expressions.csv"
LARGEST = 1e4
"""Of a coefficient."""
ROUNDS, NEAR = 12, 0.05
"""Of laying the faces on each other; metres behind the tip of the nose that count for it, as a face's front does."""
MATCHED = 0.015
"""Metres at which what a vertex is told by the default face counts half."""
RIDGE = 1e-3
"""Of the coefficients beside the directions: metres that a coefficient of 1 is worth."""


def read_matrix(path: str | Path, coefficients: int | None = None) -> np.ndarray:
    """(c, 52), columns in our order, of so many coefficients where it is said. Raises `InputError` naming the line."""
    text = read_text(path, "a table of numbers")
    try:
        rows = [row for row in csv.reader(text.splitlines()) if any(map(str.strip, row))]
    except csv.Error as error:
        raise InputError(path, "", "a readable CSV file", error) from None
    names = [name.strip() for name in rows[0]] if rows else []
    if sorted(names) != sorted(EXPRESSION_NAMES):
        wrong = next((name for name in names if name not in EXPRESSION_NAMES), f"{len(set(names))} names")
        raise InputError(path, "line 1", "the 52 names, each once", wrong)
    if len(rows) - 1 != (coefficients or max(1, len(rows) - 1)):
        raise InputError(
            path, "", f"{coefficients or 'some'} lines of numbers, one a coefficient of the face", len(rows) - 1
        )
    values = np.array([_numbers(row, k, path) for k, row in enumerate(rows[1:], 2)])
    return values[:, [names.index(name) for name in EXPRESSION_NAMES]]


def write_matrix(path: str | Path, matrix: np.ndarray) -> None:
    """As `read_matrix` reads it. Raises `InputError` where it cannot be written."""
    lines = [",".join(EXPRESSION_NAMES), *(",".join(f"{value:.4g}" for value in row) for row in matrix)]
    write_text(path, "\n".join(lines) + "\n")


def guessed(face: TemplateModel, default: TemplateModel) -> np.ndarray:
    """(c, 52): the coefficients by which `face` moves most as the `default` face does, laid on each other by their fronts."""
    vertices, other = face.v_template.double().numpy(), default.v_template.double().numpy()
    turn, size, shift = _laid(vertices, other)
    away, near = cKDTree(other).query(size * vertices @ turn.T + shift)
    counts = 1 / (1 + (away / MATCHED) ** 2)
    wanted = default.expression_dirs.double().numpy()[near] * counts[:, None, None]
    own = np.einsum("cd,vde->vce", size * turn, face.expression_dirs.double().numpy()) * counts[:, None, None]
    own, wanted = own.reshape(3 * len(own), -1), wanted.reshape(3 * len(wanted), -1)
    return np.asarray(np.linalg.solve(own.T @ own + RIDGE**2 * np.eye(own.shape[1]), own.T @ wanted))


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


def _laid(vertices: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Turn (3, 3), size and shift (3,) that lay a face on another: tips of the noses first, then the nearest points of the fronts."""
    tip, there = (points[points[:, 2].argmax()] for points in (vertices, other))
    front = vertices[vertices[:, 2] > tip[2] - NEAR]
    turn, size, shift = np.eye(3), 1.0, there - tip
    tree = cKDTree(other)
    for _ in range(ROUNDS):
        to = other[tree.query(size * front @ turn.T + shift)[1]]
        here, middle = front.mean(0), to.mean(0)
        turn = Rotation.align_vectors(to - middle, front - here)[0].as_matrix()
        size = float(np.linalg.norm(to - middle) / np.linalg.norm(front - here))
        shift = middle - size * turn @ here
    return turn, size, shift
