"""Read any motion file by its kind."""

from __future__ import annotations

import json
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.signals.bvh import read_bvh
from avatarrex.signals.livelink import read_livelink
from avatarrex.signals.sequence import SignalSequence
from avatarrex.signals.signals import Signals
from avatarrex.signals.smplx_npz import read_smplx


def read_motion(path: str | Path) -> SignalSequence:
    """`.bvh`, `.npz` (SMPL-X, AMASS), `.csv` (Live Link Face) or our `.json`. Raises `InputError`."""
    path = Path(path)
    readers = {".bvh": read_bvh, ".npz": read_smplx, ".csv": read_livelink, ".json": read_json}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, "", "a motion file: " + ", ".join(readers), path.suffix or "no extension")
    if not path.is_file():
        raise InputError(path, "", "a motion file", "nothing there")
    return reader(path)


def read_json(path: str | Path) -> SignalSequence:
    """One frame of `Signals.to_json`, or {"fps": …, "frames": […]}."""
    try:
        data = json.loads(Path(path).read_text())
    except (OSError, ValueError) as error:
        raise InputError(path, "", "a JSON file", error) from None
    if isinstance(data, dict) and "frames" in data:
        frames = tuple(Signals.from_json(frame, str(path)) for frame in data["frames"])
        return SignalSequence(frames, float(data.get("fps", 30)), Path(path).name)
    return SignalSequence((Signals.from_json(data, str(path)),), 30.0, Path(path).name)


def write_json(path: str | Path, sequence: SignalSequence) -> None:
    """Write what `read_json` reads."""
    Path(path).write_text(json.dumps({"fps": sequence.fps, "frames": [frame.to_json() for frame in sequence]}))
