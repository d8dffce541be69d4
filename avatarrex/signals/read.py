"""Read any motion file by its kind."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is, write_text
from avatarrex.files.json_text import read_json as read_json_file
from avatarrex.signals.asf import read_amc
from avatarrex.signals.bvh import read_bvh
from avatarrex.signals.driving import Signals
from avatarrex.signals.fbx import SECONDS, read_fbx
from avatarrex.signals.hand_landmarks import is_landmarks, landmark_motion, tracks_of
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.livelink import read_livelink
from avatarrex.signals.mano import read_mano
from avatarrex.signals.own_motions import MOTIONS, resolved
from avatarrex.signals.sequence import SignalSequence, check_frames, check_rate
from avatarrex.signals.smplx_npz import read_smplx, read_vectors
from avatarrex.signals.speech import read_speech

FORMAT, VERSION = "avatarrex-signals", 1
READERS: dict[str, Callable[[Path, ImportOptions], ImportedMotion]] = {
    ".bvh": read_bvh, ".amc": read_amc, ".fbx": read_fbx, ".npz": read_smplx, ".npy": read_vectors, ".pkl": read_mano, ".csv": read_livelink,
    ".wav": read_speech,
    ".json": lambda path, options: _of_json(path, options),
}  # fmt: skip
"""What reads a file, by its extension."""


def read_motion(path: str | Path, options: ImportOptions | None = None) -> SignalSequence:
    """Read a motion by its extension (`READERS`), or one that comes with the program by its name (`own_motions.MOTIONS`).

    Whatever the skeleton, the frames are our `Signals` (radians, metres, the person's feet on the floor, looking at the camera at
    first); `notes` of the sequence say what the reader decided and warn. Raises `InputError` with file and field.
    """
    return import_motion(path, options).sequence


def import_motion(
    path: str | Path, options: ImportOptions | None = None, fbx_seconds: float = SECONDS
) -> ImportedMotion:
    """As `read_motion`, with every guess, the file's own skeleton and how far its directions are from ours.

    `options` decide what would be guessed; `fbx_seconds`: the longest that Blender may take over an `.fbx`. Raises `InputError`.
    """
    path, options = resolved(path), options or ImportOptions()
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        named = "" if path.suffix else "; or " + ", ".join(MOTIONS)
        raise InputError(path, "", "a motion file: " + ", ".join(READERS) + named, path.suffix or "no extension")
    found = what_is(path)
    if found != "a file":
        raise InputError(path, "", "a motion file", found)
    try:
        read = read_fbx(path, options, fbx_seconds) if reader is read_fbx else reader(path, options)
    except InputError as error:
        if error.source != "signals":
            raise
        # a frame that cannot be: say whose
        raise InputError(path, error.field, error.expected, error.found) from None
    return _with_unused(read, options)


def _with_unused(read: ImportedMotion, options: ImportOptions) -> ImportedMotion:
    """The motion with a warning of the options that no guess of its reader names."""
    used = {guess.option for guess in read.guesses}
    unused = [name for name in options.to_json() if name not in used]
    if not unused:
        return read
    text = f"not used, as nothing in this file depends on it: {', '.join(unused)}"
    sequence = replace(read.sequence, notes=(*read.sequence.notes, f"warning: {text}"))
    return replace(read, sequence=sequence, warnings=(*read.warnings, text))


def _of_json(path: Path, options: ImportOptions) -> ImportedMotion:
    """Our own file, as it is, at the rate that was chosen; or tracks of hand landmarks."""
    data = read_json_file(path)
    if is_landmarks(data):
        return landmark_motion(path, *tracks_of(path, data), options)
    sequence = read_json(path)
    if options.fps is not None:
        sequence = replace(sequence, fps=options.fps)
    rate = Guess("rate", f"{sequence.fps:g} frames a second", "chosen" if options.fps else "", "fps")
    guesses = (Guess("file", "AvatarReX signals", f"{len(sequence)} frames"), rate)
    return ImportedMotion(sequence, guesses, options=options)


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
