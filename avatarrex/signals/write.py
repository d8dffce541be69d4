"""Write a motion as a file of another program, by its ending; `read_motion` reads each back.

.json   ours: every signal to the last bit
.npz    SMPL-X in AMASS' layout (`poses`, `trans`, `mocap_frame_rate`, `betas`) with the 52 coefficients as `arkit52`
.csv    the face alone, as Live Link Face records it: coefficients and the head's turn, 60 rows a second
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.gate import write_text, written
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.livelink import ANGLES, FPS
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence

ENDINGS = (".json", ".npz", ".csv")
NECK, HEAD = 12, 15
"""Rows of the 55 joints."""


def write_motion(path: str | Path, sequence: SignalSequence) -> None:
    """Write the motion, whole or not at all. Raises `InputError`."""
    path = Path(path)
    writers = {".json": write_json, ".npz": _write_smplx, ".csv": _write_livelink}
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise InputError(path, "", "a motion file: " + ", ".join(ENDINGS), path.suffix or "no extension")
    writer(path, sequence)


def _write_smplx(path: Path, sequence: SignalSequence) -> None:
    arrays = {
        "poses": np.stack([frame.full_pose().reshape(165) for frame in sequence]),
        "trans": np.stack([frame.translation for frame in sequence]),
        "betas": sequence[0].shape,
        "arkit52": np.stack([frame.expression for frame in sequence]),
        "mocap_frame_rate": np.array(sequence.fps),
    }
    with written(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _write_livelink(path: Path, sequence: SignalSequence) -> None:
    even = sequence.resample(FPS)
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(["Timecode", "BlendShapeCount", *EXPRESSION_NAMES, *ANGLES])
    for number, frame in enumerate(even):
        pose = frame.full_pose()
        turn = Rotation.from_rotvec(pose[NECK]) * Rotation.from_rotvec(pose[HEAD])
        angles = [*turn.as_euler("YXZ"), *np.zeros(len(ANGLES) - 3)]
        seconds, count = divmod(number, round(FPS))
        time = f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}:{count:02}.000"
        rows.writerow([time, len(EXPRESSION_NAMES) + len(ANGLES), *(f"{value:.9g}" for value in frame.expression),
                       *(f"{value:.9g}" for value in angles)])  # fmt: skip
    write_text(path, table.getvalue())
