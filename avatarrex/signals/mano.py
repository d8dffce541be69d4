"""MANO sequences: the fingers of one hand (docs/signals.md). Letters: t frames.

`poses` or `pose` (t, 48) is the hand's turn in its camera and 45 angles, or fewer columns, 3 + n, with n PCA coefficients; `hand_pose`
(t, 45 or n) is the fingers alone. The turn, the path and the betas belong to that camera and that hand: fingers alone are read.
Which hand it is and whether the mean hand is in the numbers is said by the file or by the user, never guessed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.assets import require
from avatarrex.files.pickles import read_pickle
from avatarrex.signals.hand_rotations import FLAGS, REMEDY, fingers
from avatarrex.signals.import_options import SIDES, ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.joints import JOINT_ROWS
from avatarrex.signals.sequence import SignalSequence, check_frames, check_rate, stack

POSES = ("poses", "pose", "hand_pose")
SIDE_KEYS = ("side", "hand", "is_right", "is_rhand")
KEYS = (*POSES, *SIDE_KEYS, *FLAGS, "fps")
HAND_ONLY = ("hand_pose", *SIDE_KEYS)
"""Of `KEYS` what a file of a whole body does not have."""
WIDEST = 48
"""Columns: the hand's turn and 15 joints."""


def is_hand(arrays: dict[str, np.ndarray]) -> bool:
    """Whether a file's arrays are of a hand alone."""
    if "hand_pose" in arrays and not {"body_pose", "pose_body"} & arrays.keys():
        return True
    pose = next((arrays[key] for key in POSES if key in arrays), None)
    return pose is not None and pose.ndim == 2 and 3 < pose.shape[1] <= WIDEST


def read_mano(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read a pickle of arrays by `KEYS`. Raises `InputError`."""
    data = read_pickle(path, "a MANO sequence")
    if not isinstance(data, dict):
        raise InputError(path, "", "a dictionary with " + " or ".join(POSES), type(data).__name__)
    arrays = {key: np.asarray(data[key]) for key in KEYS if key in data}
    if not is_hand(arrays):
        raise InputError(
            path, "poses", f"of a hand: shape (frames, 4 … {WIDEST})", ", ".join(map(str, data))[:80] or "nothing"
        )
    return hand_motion(path, arrays, options)


def hand_motion(path: Path, arrays: dict[str, np.ndarray], options: ImportOptions) -> ImportedMotion:
    """The motion of arrays by `KEYS`. Raises `InputError`."""
    key = next(key for key in reversed(POSES) if key in arrays)
    values = require(arrays, path, key, (None, None))
    check_frames(len(values), path, key)
    if not np.isfinite(values).all() or not len(values):
        raise InputError(path, key, "finite numbers of at least one frame", values.shape)
    turned = key != "hand_pose"
    side, said = _side(path, arrays, options)
    found = fingers(values[:, 3:] if turned else values, side, arrays, path, options)
    if found is None:
        raise InputError(path, "flat_hand_mean", f"it in the file, or {REMEDY}", "nothing")
    pose = np.zeros((len(values), 55, 3))
    pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = found.pose
    fps = options.fps or (check_rate(arrays["fps"], path, "fps") if "fps" in arrays else 30.0)
    rate = "chosen" if options.fps else "fps" if "fps" in arrays else "no frame rate in the file: taken as 30 a second"
    guesses = (
        Guess("file", f"MANO, {key}", f"{len(values)} frames"),
        Guess("hand", side, said, "side"),
        Guess("fingers", found.how, found.why, "hand_mean"),
        Guess("rate", f"{fps:g} frames a second", rate, "fps"),
    )
    notes = (*map(str, guesses), "the hand's turn in its camera, its path and its betas: not applied")
    sequence = SignalSequence(stack(pose, np.zeros((len(pose), 3)), None), fps, path.name, notes)
    return ImportedMotion(sequence, guesses, options=options)


def _side(path: Path, arrays: dict[str, np.ndarray], options: ImportOptions) -> tuple[str, str]:
    """Which hand, and who says so. Raises `InputError`."""
    if options.side:
        return options.side, "chosen"
    for key in SIDE_KEYS:
        value = np.ravel(arrays.get(key, ()))
        if value.size and str(value[0]).lower() in SIDES:
            return str(value[0]).lower(), key
        if key.startswith("is_") and value.size and value.dtype.kind in "bfiu" and (value == value[0]).all():
            return SIDES[int(bool(value[0]))], key
    raise InputError(path, "side", "left or right in the file, or --side left|right", "nothing")
