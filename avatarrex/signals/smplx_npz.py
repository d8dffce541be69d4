"""SMPL, SMPL-H and SMPL-X motions of `.npz` and `.npy` files (docs/signals.md): full axis-angle or matrices, metres. Letters: t frames.

Three layouts of arrays: `poses` of all joints with a path; one array a part (`root_orient`, `pose_body` … or `global_orient`,
`body_pose` …), with the names that estimators of other makers give them; vectors of one frame a row (`VECTORS`). A file's betas belong
to its own model and its expression coefficients to its own face: neither is applied. Files with `arkit52` are captures in this
project's layout: their 52 coefficients and their exact path are read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_array, read_arrays
from avatarrex.files.assets import numbers, require
from avatarrex.signals import mano
from avatarrex.signals.contacts import locked
from avatarrex.signals.driving import LARGEST
from avatarrex.signals.expression_map import LARGEST as LARGEST_COEFFICIENT
from avatarrex.signals.expression_map import read_expression_map
from avatarrex.signals.faceverse import LAYOUTS, faceverse_motion
from avatarrex.signals.ground import WORDS, grounded
from avatarrex.signals.hand_landmarks import is_track, landmark_motion
from avatarrex.signals.hand_rotations import FLAGS, hands_of
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion, feet
from avatarrex.signals.joints import JOINT_ROWS
from avatarrex.signals.motion_keys import POSES, RATE_KEYS, rate_of
from avatarrex.signals.sequence import MOST_FRAMES, SignalSequence, check_frames, stack
from avatarrex.signals.suspicion import suspicions
from avatarrex.signals.world_axes import pelvis_axes

PATHS = ("trans", "transl", "trans_world", "smpl_trans", "cam_trans", "translation")
"""The path in metres, a world's before a camera's."""
SAME = {
    "lhand_pose": "left_hand_pose", "rhand_pose": "right_hand_pose", "pose_lhand": "left_hand_pose", "pose_rhand": "right_hand_pose",
    "left_eye_pose": "leye_pose", "right_eye_pose": "reye_pose",
}  # fmt: skip
"""Names of other makers for the arrays of `ROWS`."""
ROWS = {
    "pose_hand": slice(25, 55), **JOINT_ROWS, "root_orient": JOINT_ROWS["global_orient"], "pose_body": JOINT_ROWS["body_pose"],
    "pose_jaw": JOINT_ROWS["jaw_pose"], "pose_eye": JOINT_ROWS["eye_pose"],
}  # fmt: skip
"""Rows of the 55 rotation vectors by the key of a file by parts."""
KEYS = tuple(dict.fromkeys((*POSES, *PATHS, "arkit52", "expression", *RATE_KEYS, *ROWS, *SAME, *FLAGS, *mano.KEYS)))
LARGEST_BYTES = 2 * 8 * MOST_FRAMES * 165
"""Of a file's arrays: twice what the longest motion's poses take in double precision."""
WIDTHS = {
    165: ("SMPL-X", range(55)), 156: ("SMPL-H", [*range(22), *range(25, 55)]), 72: ("SMPL", range(22)), 66: ("SMPL-X body", range(22)),
}  # fmt: skip
"""Numbers of a frame, the model, and which of our joints they turn: SMPL's last two, its hands, are not read."""
VECTORS: dict[int, tuple[str, dict[str, slice]]] = {
    265: ("TalkSHOW", {"jaw_pose": slice(0, 3), "leye_pose": slice(3, 6), "reye_pose": slice(6, 9), "global_orient": slice(9, 12),
                       "body_pose": slice(12, 75), "left_hand_pose": slice(75, 120), "right_hand_pose": slice(120, 165)}),
    322: ("Motion-X", {"root_orient": slice(0, 3), "pose_body": slice(3, 66), "pose_hand": slice(66, 156), "pose_jaw": slice(156, 159),
                       "trans": slice(309, 312)}),
}  # fmt: skip
"""Vectors of one frame by their length, and where its parts are; what is left out belongs to another face and body."""


def read_smplx(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read a motion of any layout of arrays. Raises `InputError` naming the key."""
    arrays = read_arrays(path, KEYS, LARGEST_BYTES)
    if mano.is_hand(arrays):
        return mano.hand_motion(path, arrays, options)
    arrays = {key: value for key, value in arrays.items() if key not in mano.HAND_ONLY}
    for other, name in SAME.items():
        if other in arrays:
            arrays.setdefault(name, arrays.pop(other))
    return _imported(path, arrays, options, "npz")


def read_vectors(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read vectors of one frame a row. Raises `InputError`."""
    vectors = read_array(path, LARGEST_BYTES)
    if is_track(vectors):
        return landmark_motion(path, {"": vectors}, None, options)
    if vectors.dtype.kind in "fiu" and vectors.ndim == 2 and vectors.shape[1] in LAYOUTS:
        return faceverse_motion(path, vectors, options)
    if vectors.dtype.kind in "fiu" and vectors.ndim == 2 and vectors.shape[1] == mano.WIDEST:
        return mano.hand_motion(path, {"poses": vectors}, options)
    known = {
        **{width: name for width, (name, _) in WIDTHS.items()},
        **{width: name for width, (name, _) in VECTORS.items()},
    }
    if vectors.dtype.kind not in "fiu" or vectors.ndim != 2 or vectors.shape[1] not in known:
        expected = " or ".join(f"(frames, {width}) {name}" for width, name in sorted(known.items()))
        raise InputError(path, "", f"numbers of shape {expected}", f"{vectors.shape} of {vectors.dtype}")
    width = vectors.shape[1]
    parts = VECTORS[width][1] if width in VECTORS else {"poses": slice(None)}
    return _imported(path, {name: vectors[:, part] for name, part in parts.items()}, options, f"npy, {known[width]}")


def _imported(path: Path, arrays: dict[str, np.ndarray], options: ImportOptions, kind: str) -> ImportedMotion:
    """A motion of arrays by `KEYS`."""
    flags = {key: arrays.pop(key) for key in FLAGS if key in arrays}
    for key, value in arrays.items():
        check_frames(len(np.atleast_1d(value)), path, key)
        if value.dtype.kind not in "fiu" or value.dtype.itemsize > 8:
            wanted = "numbers of at most 64 bits" if value.dtype.kind in "fiu" else "numbers"
            raise InputError(path, key, wanted, value.dtype)
    poses = next((key for key in POSES if key in arrays), None)
    arrays = {key: _axis_angle(key, value) for key, value in arrays.items()}
    check_magnitudes(arrays, path)
    rate, fps = rate_of(arrays, path, options)
    hands, warnings = hands_of(arrays, flags, path, options)
    notes = list[str]()
    full, model = _poses(arrays, path, poses) if poses else (_by_parts(arrays, path), "SMPL-X by parts")
    walked = next((key for key in PATHS if key in arrays), None)
    translation = np.zeros((len(full), 3))
    if walked:
        translation = require(arrays, path, walked, (len(full), 3)).astype(np.float64) * (options.metres or 1.0)
    guesses = [Guess("file", f"{kind}, {model}", f"{len(full)} frames; path: {walked or 'none'}"), rate, hands]
    if walked:
        guesses += [Guess("unit", options.unit or "metres", "chosen" if options.unit else "", "unit")]
    expression = None
    if "arkit52" in arrays:
        expression = np.clip(require(arrays, path, "arkit52", (len(full), 52)).astype(np.float64), 0, 1)
        notes.append("a capture in our layout: axes and floor as stored")
    else:
        if "expression" in arrays and options.expressions:
            expression, guess = _mapped(arrays, path, len(full), options)
            guesses.append(guess)
        elif "expression" in arrays:
            guesses.append(Guess("expression", "not applied", "coefficients of another face", "expressions"))
        world, axes = pelvis_axes(path, full[:, 0], options)
        translation, floor = _placed(full, translation, world, options, fps)
        guesses += [*axes, floor, feet(options)]
    warnings += suspicions(full, translation, fps)
    if not full[:, 25:].any():
        notes.append("no finger moves: flat hands")
    said = (*map(str, guesses), *notes, *(f"warning: {text}" for text in warnings))
    sequence = SignalSequence(stack(full, translation, expression), fps, path.name, said)
    return ImportedMotion(sequence, tuple(guesses), tuple(warnings), options=options)


def _axis_angle(key: str, value: np.ndarray) -> np.ndarray:
    """Rotation matrices (t, k, 3, 3), or (t, 3, 3) of a part of one joint, as rotation vectors; those, (t, k, 3), as (t, 3 k); else the
    value itself."""
    rows = ROWS.get(key)
    single = rows is not None and rows.stop - rows.start == 1
    matrices = value.ndim == 4 or (single and value.ndim == 3)
    if (
        value.ndim == 3
        and value.shape[2] == 3
        and (rows is not None or key in POSES)
        and not (single and value.shape[1] == 3)
    ):
        return value.reshape(len(value), 3 * value.shape[1])
    if not matrices or value.shape[-2:] != (3, 3) or not np.isfinite(value).all():
        return value
    flat = value.reshape(-1, 3, 3).astype(np.float64)
    if not len(flat) or (np.linalg.det(flat) < 0.5).any():
        return value
    return np.asarray(Rotation.from_matrix(flat).as_rotvec().reshape(len(value), -1))


def _mapped(arrays: dict[str, np.ndarray], path: Path, count: int, options: ImportOptions) -> tuple[np.ndarray, Guess]:
    """(t, 52) of the file's own coefficients, by the table that was chosen."""
    values = numbers(require(arrays, path, "expression", (count, None)), path, "expression", LARGEST_COEFFICIENT)
    table = read_expression_map(options.expressions, values.shape[1], wider=True)
    how = f"by {table.rows} rows of {Path(options.expressions).name}"
    if table.columns > values.shape[1]:
        how += f", the first {values.shape[1]} of its {table.columns} columns"
    return table(values), Guess("expression", how, "chosen", "expressions")


def _poses(arrays: dict[str, np.ndarray], path: Path, key: str) -> tuple[np.ndarray, str]:
    """(t, 55, 3) of an array of all joints, and the model."""
    poses = require(arrays, path, key, (None, None)).astype(np.float64)
    if poses.shape[1] not in WIDTHS or not len(poses):
        expected = " or ".join(f"(any, {width}) {model}" for width, (model, _) in WIDTHS.items())
        raise InputError(path, key, f"shape {expected}", poses.shape)
    model, joints = WIDTHS[poses.shape[1]]
    full = np.zeros((len(poses), 55, 3))
    full[:, joints] = poses.reshape(len(poses), -1, 3)[:, : len(joints)]
    return full, f"{model}, {key}"


def _by_parts(arrays: dict[str, np.ndarray], path: Path) -> np.ndarray:
    """(t, 55, 3) from one array per part; the body must be there."""
    body = next((key for key in ("body_pose", "pose_body") if key in arrays), None)
    if body is None:
        found = f"only {', '.join(sorted(arrays)[:12])}" if arrays else "none of a motion's keys"
        raise InputError(path, "poses", "poses, pose_body or body_pose", found)
    value = arrays[body]
    if value.ndim == 2 and value.shape[1] == 69:  # SMPL's 23 joints: the last two are its hands
        arrays = {**arrays, body: value[:, :63]}
    return joint_rotations(arrays, path, body)


def _placed(
    full: np.ndarray, translation: np.ndarray, world: np.ndarray, options: ImportOptions, fps: float
) -> tuple[np.ndarray, Guess]:
    """The path turned by `world`, from above the origin, on the floor; `full` is changed in place."""
    full[:, 0] = (Rotation.from_matrix(world) * Rotation.from_rotvec(full[:, 0])).as_rotvec()
    how = options.floor or "contacts"
    moved = grounded(full, (translation - translation[0]) @ world.T, how, fps)
    if options.lock_feet:
        full[:] = locked(full, moved, fps)
    return moved, Guess("floor", WORDS[how], "chosen" if options.floor else "", "floor")


def check_magnitudes(arrays: dict[str, np.ndarray], source: str | Path) -> None:
    """Raise `InputError` for rotations or a path beyond what `Signals` may be; what is not finite is refused by its reader."""
    for key, value in arrays.items():
        if key in ROWS or key in POSES or key in PATHS:
            measure, name = ("metres", "translation") if key in PATHS else ("radians", "body_pose")
            found = float(np.abs(value).max(initial=0))
            if LARGEST[name] < found < np.inf:
                raise InputError(source, key, f"{measure} up to {LARGEST[name]:g}", f"{found:g}")


def joint_rotations(arrays: dict[str, np.ndarray], source: str | Path, body: str) -> np.ndarray:
    """(t, 55, 3) from one array for each part of a pose that is there, at rest elsewhere; the array `body` says how many frames.

    Raises `InputError` naming the key.
    """
    count = len(np.atleast_1d(arrays[body]))
    check_frames(count, source, body)
    if not count:
        raise InputError(source, body, "at least one frame", 0)
    full = np.zeros((count, 55, 3))
    for key, joints in ROWS.items():
        if key in arrays:
            full[:, joints] = rows(arrays, source, key, count, 3 * (joints.stop - joints.start)).reshape(count, -1, 3)
    return full


def rows(arrays: dict[str, np.ndarray], source: str | Path, key: str, count: int, width: int) -> np.ndarray:
    """`arrays[key]` as (count, width), stored so or with its joints apart; hands of fewer columns are PCA. Raises `InputError`."""
    value = arrays.get(key)
    if value is not None and value.ndim == 3 and value.shape[2] == 3:
        value = value.reshape(len(value), -1)
    found = require({} if value is None else {**arrays, key: value}, source, key, (None, None))
    if "hand" in key and 0 < found.shape[1] < width:
        raise InputError(source, key, f"{width} columns of axis-angle (PCA off)", f"{found.shape[1]} columns")
    if found.shape != (count, width):
        expected = f"shape ({count}, {width})" + (", as many frames as body_pose" if len(found) != count else "")
        raise InputError(source, key, expected, found.shape)
    return found
