"""Live Link Face CSV: 52 Apple blend shapes with head and eye angles, radians, one row a frame.

Signs, checked against a recording of a person who looks at the phone while the head turns (head and eye yaw then cancel, and
eye angles follow the eyeLook coefficients): head yaw to the person's left, pitch down, roll towards the person's right
shoulder are positive. Eye angles say what the eyeLook coefficients say: the coefficients are read, the eye joints rest.
"""

from __future__ import annotations

import csv
import re
from array import array
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from avatarrex.errors import InputError
from avatarrex.files.gate import read_lines
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.sequence import SignalSequence, check_frames, stack

FPS = 60.0
TIMECODE_RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 120.0)
HEAD = ("HeadYaw", "HeadPitch", "HeadRoll")
ANGLES = (*HEAD, *(f"{part}{angle}" for part in ("LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll")))
OPTIONAL = ("tongueOut", *HEAD)
"""Columns that older recordings lack: zero then, with a note."""
LARGEST_VALUE = 100.0
"""Coefficients are at most 1, angles at most 2π: beyond this it is another file."""
LONGEST_GAP = 10.0
"""Seconds between rows that are still one recording."""
LONGEST_MEAN_GAP = 0.25
"""Seconds between rows, on average: what is sparser is no recording of a face, and would be filled with sixty times its rows."""
WANTED = (*EXPRESSION_NAMES, *HEAD)
_KNOWN = {"timecode", "blendshapecount", *(name.lower() for name in (*WANTED, *ANGLES[3:]))}


def read_livelink(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read a Live Link Face recording; the head's turn is shared by neck and head. Raises `InputError`."""
    values, timecodes, notes = _rows(path)
    # about +Y to the person's left, about +X down, about +Z towards the right shoulder
    turns = Rotation.from_euler("YXZ", values[:, 52:])
    weights = values[:, :52]
    times, fps, note = _times(path, timecodes)
    if options.fps is not None:
        times, fps, note = None, options.fps, f"{options.fps:g} frames a second, chosen"
    if times is not None and np.abs(np.diff(times) * fps - 1).max(initial=0) > 1e-3:
        count = int((times[-1] - times[0]) * fps + 1.5)
        check_frames(count, path, "Timecode")
        even = np.clip(times[0] + np.arange(count) / fps, times[0], times[-1])
        weights = np.stack([np.interp(even, times, column) for column in weights.T], 1)
        turns = Slerp(times, turns)(even)
        note += f"; uneven frame times: {len(times)} rows resampled to {len(even)}"
    pose = np.zeros((len(weights), 55, 3))
    pose[:, 12] = pose[:, 15] = turns.as_rotvec() / 2
    notes += [note, "eye angles are in the eyeLook coefficients; the eye joints stay at rest"]
    if weights.min() < 0 or weights.max() > 1:
        notes.append(f"coefficients from {weights.min():.2f} to {weights.max():.2f} clipped to 0 … 1")
    frames = stack(pose, np.zeros((len(weights), 3)), np.clip(weights, 0, 1))
    guesses = (
        Guess("file", "Live Link Face", f"{len(frames)} frames"),
        Guess("rate", f"{fps:g} frames a second", note, "fps"),
    )
    return ImportedMotion(SignalSequence(frames, fps, path.name, tuple(notes)), guesses, options=options)


def _rows(path: Path) -> tuple[np.ndarray, list[str], list[str]]:
    """(t, 55): 52 coefficients and the head's three angles; timecodes, none where there is no such column; notes on columns."""
    reader = csv.reader(read_lines(path, "a CSV file", errors="replace"))
    try:
        rows = enumerate((row for row in reader if row), start=1)
        head = next(rows, (0, []))[1]
        names = [name.strip().lstrip("\ufeff").lower() for name in head]
        columns, timecode = _columns(path, names) if head else ([], -1)
        values, timecodes = array("d"), list[str]()
        for number, row in rows:
            check_frames(number - 1, path, "rows")
            if len(row) != len(head):
                raise InputError(path, f"line {number}", f"{len(head)} values", len(row))
            values.extend(_number(path, number, name, row[k]) if k >= 0 else 0.0 for name, k in zip(WANTED, columns))
            if timecode >= 0:
                timecodes.append(row[timecode].strip())
    except csv.Error as error:
        raise InputError(path, "", "a readable CSV file", error) from None
    if not values:
        raise InputError(path, "rows", "a header and at least one frame", 1 if head else 0)
    missing = [name for name, k in zip(WANTED, columns) if k < 0]
    extra = [name for name, known in zip(head, names) if known not in _KNOWN]
    notes = [f"not in the file, at rest: {', '.join(missing)}"] if missing else []
    notes += [f"columns not read: {', '.join(extra)[:120]}"] if extra else []
    return np.frombuffer(values).reshape(-1, len(WANTED)), timecodes, notes


def _columns(path: Path, names: list[str]) -> tuple[list[int], int]:
    """The column of each of `WANTED`, -1 for one that older recordings lack, and the timecode's."""
    places = {name: k for k, name in enumerate(names)}
    for name in WANTED:
        if name.lower() not in places and name not in OPTIONAL:
            raise InputError(path, "header", f"a column {name}", f"{len(places)} columns")
    return [places.get(name.lower(), -1) for name in WANTED], places.get("timecode", -1)


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(path, f"line {line}: {name}", "a number", text) from None
    if not abs(value) <= LARGEST_VALUE:  # also true of NaN
        raise InputError(path, f"line {line}: {name}", f"a finite number up to {LARGEST_VALUE:g}", value)
    return value


def _times(path: Path, timecodes: list[str]) -> tuple[np.ndarray | None, float, str]:
    """Seconds of each row from its timecode `hh:mm:ss:ff.fraction`, the rate it counts in, and a note."""
    if not timecodes:
        return None, FPS, f"no timecode: taken as {FPS:g} frames a second"
    parts = []
    for number, text in enumerate(timecodes, start=2):
        match = re.fullmatch(r"(\d{1,3})[:;](\d{1,3})[:;](\d{1,3})[:;](\d{1,3}(?:\.\d+)?)", text)
        if match is None:
            raise InputError(path, f"line {number}: Timecode", "hh:mm:ss:ff.fraction", text)
        parts.append([float(word) for word in match.groups()])
    hours, minutes, seconds, frames = np.array(parts).T
    whole = hours * 3600 + minutes * 60 + seconds
    # frame numbers start again every second: a recording that crosses two such ends shows the rate
    crossed = whole[-1] - whole[0] >= 2 or frames.max() >= 30
    rate = (
        next((rate for rate in TIMECODE_RATES if rate > np.floor(frames.max())), TIMECODE_RATES[-1]) if crossed else FPS
    )
    times = whole + frames / rate
    steps = np.diff(times)
    back = np.flatnonzero((steps <= 0) | (steps > LONGEST_GAP))
    if len(back):
        what = "stands or turns back" if steps[back[0]] <= 0 else f"jumps by {steps[back[0]]:.0f} s"
        return None, rate, f"the timecode {what} at line {back[0] + 3}: taken as {rate:g} frames a second"
    if len(steps) and steps.mean() > LONGEST_MEAN_GAP:
        raise InputError(
            path, "Timecode", f"rows at most {LONGEST_MEAN_GAP:g} s apart on average", f"{steps.mean():.3g} s"
        )
    return times, rate, f"{rate:g} frames a second" + (" by the timecode" if crossed else " assumed: too short to tell")
