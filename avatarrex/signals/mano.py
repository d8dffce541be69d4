"""MANO sequences: the fingers of one hand (docs/signals.md). Letters: t frames.

`poses` or `pose` (t, 48) is the hand's turn in its camera and 45 angles, or fewer columns, 3 + n, with n PCA coefficients; `hand_pose`
(t, 45 or n) is the fingers alone. Joints may have a side of their own: (t, 16, 3), (t, 15, 3). The turn, the path and the betas belong to
that camera and that hand: fingers alone are read.
Which hand it is and whether the mean hand is in the numbers is said by the file or by the user, never guessed.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.assets import numbers, require
from avatarrex.files.pickles import read_pickle
from avatarrex.signals.driving import LARGEST
from avatarrex.signals.hand_rotations import COLUMNS, FLAGS, REMEDY, arrays_of, convention_of, fingers, guess_of
from avatarrex.signals.import_options import SIDES, ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.joints import JOINT_ROWS
from avatarrex.signals.motion_keys import POSES as BODIES
from avatarrex.signals.motion_keys import RATE_KEYS, rate_of
from avatarrex.signals.sequence import SignalSequence, check_frames, stack

POSES = ("poses", "pose", "hand_pose")
SIDE_KEYS = ("side", "hand", "is_right", "is_rhand")
KEYS = (*POSES, *SIDE_KEYS, *FLAGS, *RATE_KEYS)
PARTS = ("body_pose", "pose_body")
"""Of a whole body."""
HAND_ONLY = ("hand_pose", *SIDE_KEYS)
"""Of `KEYS` what a file of a whole body does not have."""
WIDEST = 48
"""Columns: the hand's turn and 15 joints."""


def is_hand(arrays: dict[str, np.ndarray]) -> bool:
    """Whether a file's arrays are of a hand alone: none of its poses is as wide as a body's."""
    shapes = [arrays[key].shape for key in BODIES if key in arrays]
    if any(key in arrays for key in PARTS) or any(math.prod(shape[1:]) > WIDEST for shape in shapes):
        return False
    pose = next((arrays[key] for key in POSES if key in arrays), None)
    return "hand_pose" in arrays or (
        pose is not None and (pose.shape[1:] == (16, 3) or (pose.ndim == 2 and pose.shape[1] > 3))
    )


def read_mano(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read a pickle of arrays by `KEYS`. Raises `InputError`."""
    data = read_pickle(path, "a MANO sequence")
    if not isinstance(data, dict):
        raise InputError(path, "", "a dictionary with " + " or ".join(POSES), type(data).__name__)
    arrays = arrays_of(data, (*KEYS, *BODIES, *PARTS), path)
    if not is_hand(arrays):
        raise InputError(
            path, "poses", f"of a hand: shape (frames, 4 … {WIDEST})", ", ".join(map(str, data))[:80] or "nothing"
        )
    return hand_motion(path, arrays, options)


def hand_motion(path: Path, arrays: dict[str, np.ndarray], options: ImportOptions) -> ImportedMotion:
    """The motion of arrays by `KEYS`. Raises `InputError`."""
    key = next(key for key in reversed(POSES) if key in arrays)
    turn = 0 if key == "hand_pose" else 3
    given = arrays[key]
    if given.shape[1:] == (turn // 3 + COLUMNS // 3, 3):
        given = given.reshape(len(given), -1)
    values = numbers(require({key: given}, path, key, (None, None)), path, key, LARGEST["left_hand_pose"])
    check_frames(len(values), path, key)
    if not len(values) or not 0 < values.shape[1] - turn <= COLUMNS:
        raise InputError(path, key, f"at least one frame of {turn + 1} … {turn + COLUMNS} numbers", values.shape)
    side, said = _side(path, arrays, options)
    convention = convention_of(arrays, (side,), path, options)
    if convention.flat is None:
        raise InputError(path, "flat_hand_mean", f"it in the file, or {REMEDY}", "nothing")
    found = fingers(values[:, turn:], side, convention)
    pose = np.zeros((len(values), 55, 3))
    pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = found.pose
    rate, fps = rate_of(arrays, path, options)
    guesses = (
        Guess("file", f"MANO, {key}", f"{len(values)} frames"),
        Guess("hand", side, said, "side"),
        guess_of("fingers", [found], convention),
        rate,
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
        if not value.size or not (value == value[0]).all():
            continue
        if str(value[0]).lower() in SIDES:
            return str(value[0]).lower(), key
        if key.startswith("is_") and value.dtype.kind in "bfiu":
            return SIDES[int(bool(value[0]))], key
    raise InputError(path, "side", "left or right in the file, or --side left|right", "nothing")
