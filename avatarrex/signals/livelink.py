"""Live Link Face CSV: 52 Apple blend shapes with head and eye angles, radians, one row a frame.

Signs, held against a recording of a person who looks at the phone while the head turns (head and eye yaw then cancel, and
eye angles follow the eyeLook coefficients): head yaw to the person's left, pitch down, roll towards the person's right
shoulder are positive. Eye angles say what the eyeLook coefficients say: the coefficients are read, the eye joints rest.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from avatarrex.errors import InputError
from avatarrex.files.gate import read_text
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.sequence import SignalSequence, stack

FPS = 60.0
RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 120.0)
HEAD = ("HeadYaw", "HeadPitch", "HeadRoll")
ANGLES = (*HEAD, *(f"{part}{angle}" for part in ("LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll")))
OPTIONAL = ("tongueOut", *HEAD)
"""Columns that older recordings lack: zero then, with a note."""
LARGEST = 100.0
"""Coefficients are at most 1, angles at most 2π: beyond this it is another file."""
GAP = 10.0
"""Seconds between rows that are still one recording."""
_IGNORED = {"timecode", "blendshapecount", *(name.lower() for name in ANGLES[3:])}


def read_livelink(path: str | Path) -> SignalSequence:
    """Read a Live Link Face recording; the head's turn is shared by neck and head. Raises `InputError`."""
    path = Path(path)
    try:
        rows = [row for row in csv.reader(read_text(path, "a CSV file", errors="replace").splitlines()) if row]
    except csv.Error as error:
        raise InputError(path, "", "a readable CSV file", error) from None
    if len(rows) < 2:
        raise InputError(path, "rows", "a header and at least one frame", len(rows))
    columns = {name.strip().lstrip("\ufeff").lower(): k for k, name in enumerate(rows[0])}
    values, notes = _values(path, rows, columns)
    # about +Y to the person's left, about +X down, about +Z towards the right shoulder
    turns = Rotation.from_euler("YXZ", values[:, 52:])
    weights = values[:, :52]
    times, fps, note = _times(path, rows, columns)
    if times is not None and np.abs(np.diff(times) * fps - 1).max(initial=0) > 1e-3:
        even = times[0] + np.arange(int((times[-1] - times[0]) * fps + 1.5)) / fps
        even = np.clip(even, times[0], times[-1])
        weights = np.stack([np.interp(even, times, column) for column in weights.T], 1)
        turns = Slerp(times, turns)(even)
        note += f"; uneven frame times: {len(times)} rows resampled to {len(even)}"
    pose = np.zeros((len(weights), 55, 3))
    pose[:, 12] = pose[:, 15] = turns.as_rotvec() / 2
    notes += [note, "eye angles are in the eyeLook coefficients; the eye joints stay at rest"]
    if weights.min() < 0 or weights.max() > 1:
        notes.append(f"coefficients from {weights.min():.2f} to {weights.max():.2f} clipped to 0 … 1")
    frames = stack(pose, np.zeros((len(weights), 3)), np.clip(weights, 0, 1))
    return SignalSequence(frames, fps, path.name, tuple(notes))


def _values(path: Path, rows: list[list[str]], columns: dict[str, int]) -> tuple[np.ndarray, list[str]]:
    """(t, 55): 52 coefficients and the head's three angles; notes on columns."""
    wanted = (*EXPRESSION_NAMES, *HEAD)
    missing = [name for name in wanted if name.lower() not in columns]
    for name in missing:
        if name not in OPTIONAL:
            raise InputError(path, "header", f"a column {name}", f"{len(columns)} columns")
    known = {name.lower() for name in wanted} | _IGNORED
    extra = [name for name in rows[0] if name.strip().lstrip("\ufeff").lower() not in known]
    notes = [f"not in the file, at rest: {', '.join(missing)}"] if missing else []
    notes += [f"columns not read: {', '.join(extra)[:120]}"] if extra else []
    values = np.zeros((len(rows) - 1, len(wanted)))
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(rows[0]):
            raise InputError(path, f"line {number}", f"{len(rows[0])} values", len(row))
        for k, name in enumerate(wanted):
            if name in missing:
                continue
            text = row[columns[name.lower()]]
            try:
                values[number - 2, k] = float(text)
            except ValueError:
                raise InputError(path, f"line {number}: {name}", "a number", text) from None
    # not in range is also true of NaN
    wrong = np.argwhere(~(np.abs(values) <= LARGEST))
    if len(wrong):
        row, column = wrong[0]
        expected = f"a finite number up to {LARGEST:g}"
        raise InputError(path, f"line {row + 2}: {wanted[column]}", expected, values[row, column])
    return values, notes


def _times(path: Path, rows: list[list[str]], columns: dict[str, int]) -> tuple[np.ndarray | None, float, str]:
    """Seconds of each row from its timecode `hh:mm:ss:ff.fraction`, the rate it counts in, and a note."""
    if "timecode" not in columns:
        return None, FPS, f"no timecode: taken as {FPS:g} frames a second"
    parts = []
    for number, row in enumerate(rows[1:], start=2):
        text = row[columns["timecode"]].strip()
        match = re.fullmatch(r"(\d{1,3})[:;](\d{1,3})[:;](\d{1,3})[:;](\d{1,3}(?:\.\d+)?)", text)
        if match is None:
            raise InputError(path, f"line {number}: Timecode", "hh:mm:ss:ff.fraction", text)
        parts.append([float(word) for word in match.groups()])
    hours, minutes, seconds, frames = np.array(parts).T
    whole = hours * 3600 + minutes * 60 + seconds
    # frame numbers start again every second: a recording that crosses two such ends shows the rate
    crossed = whole[-1] - whole[0] >= 2 or frames.max() >= 30
    rate = next((rate for rate in RATES if rate > np.floor(frames.max())), RATES[-1]) if crossed else FPS
    times = whole + frames / rate
    steps = np.diff(times)
    back = np.flatnonzero((steps <= 0) | (steps > GAP))
    if len(back):
        what = "stands or turns back" if steps[back[0]] <= 0 else f"jumps by {steps[back[0]]:.0f} s"
        return None, rate, f"the timecode {what} at line {back[0] + 3}: taken as {rate:g} frames a second"
    return times, rate, f"{rate:g} frames a second" + (" by the timecode" if crossed else " assumed: too short to tell")
