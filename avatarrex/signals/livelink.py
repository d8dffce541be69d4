"""Live Link Face CSV: 52 Apple blend shapes with head and eye angles (radians, as the app writes them)."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.sequence import SignalSequence, stack

FPS = 60.0
ANGLES = tuple(f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll"))


def read_livelink(path: str | Path) -> SignalSequence:
    """Read a Live Link Face recording; the head's turn is shared by neck and head. Raises `InputError`."""
    path = Path(path)
    try:
        with path.open(newline="", errors="replace") as file:
            rows = [row for row in csv.reader(file) if row]
    except OSError as error:
        raise InputError(path, "", "a readable CSV file", error.strerror) from None
    if len(rows) < 2:
        raise InputError(path, "rows", "a header and at least one frame", len(rows))
    columns = {name.strip().lower(): k for k, name in enumerate(rows[0])}
    wanted = [*EXPRESSION_NAMES, *ANGLES]
    for name in wanted:
        if name.lower() not in columns:
            raise InputError(path, "header", f"a column {name}", f"{len(columns)} columns")
    values = np.zeros((len(rows) - 1, len(wanted)))
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(rows[0]):
            raise InputError(path, f"line {number}", f"{len(rows[0])} values", len(row))
        for k, name in enumerate(wanted):
            try:
                values[number - 2, k] = float(row[columns[name.lower()]])
            except ValueError:
                raise InputError(path, f"line {number}: {name}", "a number", row[columns[name.lower()]]) from None
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise InputError(path, f"line {row + 2}: {wanted[column]}", "a finite number", values[row, column])
    angles = values[:, 52:].reshape(-1, 3, 3)
    # yaw turns about +Y to the person's left, pitch about +X (positive looks down), roll about +Z
    turns = Rotation.from_euler("YXZ", angles.reshape(-1, 3)).as_rotvec().reshape(-1, 3, 3)
    pose = np.zeros((len(values), 55, 3))
    pose[:, 12], pose[:, 15] = turns[:, 0] / 2, turns[:, 0] / 2
    notes = ("eye angles are in the eyeLook coefficients; the eye joints stay at rest",)
    return SignalSequence(stack(pose, np.zeros((len(values), 3)), np.clip(values[:, :52], 0, 1)), FPS, path.name, notes)
