"""Read any motion file by its kind."""

from __future__ import annotations

import json
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is, write_text
from avatarrex.files.json_text import read_json as read_json_file
from avatarrex.signals.bvh import read_bvh
from avatarrex.signals.driving import Signals
from avatarrex.signals.livelink import read_livelink
from avatarrex.signals.sequence import SignalSequence, check_frames, check_rate
from avatarrex.signals.smplx_npz import read_smplx

FORMAT, VERSION = "avatarrex-signals", 1


def read_motion(path: str | Path) -> SignalSequence:
    """Read a motion by its extension: `.bvh`, `.npz` (SMPL-X, AMASS), `.csv` (Live Link Face) or our `.json`.

    Whatever the skeleton, the frames are our `Signals` (radians, metres, the person's feet on the floor); `notes` of the
    sequence say what the reader decided: axes, scale, joints that were not found. Raises `InputError` with file and field.
    """
    path = Path(path)
    readers = {".bvh": read_bvh, ".npz": read_smplx, ".csv": read_livelink, ".json": read_json}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, "", "a motion file: " + ", ".join(readers), path.suffix or "no extension")
    found = what_is(path)
    if found != "a file":
        raise InputError(path, "", "a motion file", found)
    try:
        return reader(path)
    except InputError as error:
        if error.source != "signals":
            raise
        # a frame that cannot be: say whose
        raise InputError(path, error.field, error.expected, error.found) from None


def read_json(path: str | Path) -> SignalSequence:
    """One frame of `Signals.to_json`, or a sequence: {"fps": …, "frames": […]} (assets_spec/signals.json)."""
    data = read_json_file(path)
    if not (isinstance(data, dict) and "frames" in data):
        return SignalSequence((Signals.from_json(data, str(path)),), 30.0, Path(path).name)
    known = {"format", "version", "name", "fps", "notes", "frames"}
    for key in data.keys() - known:
        raise InputError(path, key, "one of " + ", ".join(sorted(known)), "an unknown field")
    if data.get("format", FORMAT) != FORMAT:
        raise InputError(path, "format", FORMAT, data["format"])
    if data.get("version", VERSION) != VERSION:
        raise InputError(path, "version", str(VERSION), data["version"])
    rate, frames, notes = check_rate(data.get("fps", 30), path), data["frames"], data.get("notes", [])
    if not isinstance(frames, list) or not frames:
        raise InputError(
            path, "frames", "a list of at least one frame", frames if frames == [] else type(frames).__name__
        )
    check_frames(len(frames), path, "frames")
    if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
        raise InputError(path, "notes", "a list of texts", type(notes).__name__)
    signals = tuple(Signals.from_json(frame, f"{path}: frames[{k}]") for k, frame in enumerate(frames))
    return SignalSequence(signals, rate, str(data.get("name") or Path(path).name), tuple(notes))


def write_json(path: str | Path, sequence: SignalSequence) -> None:
    """Write a motion as `.json`, which `read_motion` reads back to the last bit (assets_spec/signals.json); all or nothing.

    Raises `InputError` where the file cannot be written.
    """
    data = {
        "format": FORMAT, "version": VERSION, "name": sequence.name, "fps": sequence.fps, "notes": list(sequence.notes),
        "frames": [frame.to_json() for frame in sequence],
    }  # fmt: skip
    write_text(path, json.dumps(data, ensure_ascii=False, allow_nan=False))
