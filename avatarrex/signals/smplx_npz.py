"""SMPL-X and AMASS `.npz` motions (assets_spec/motions.md): full axis-angle, metres. Letters: t frames.

Three layouts: `poses` (t, 156 SMPL+H or 165 SMPL-X) with `trans`; the same by parts, `root_orient`, `pose_body`, `pose_hand`,
`pose_jaw`, `pose_eye`; AvatarReX's `body_pose` (t, 63) with `global_orient`, `transl`, `jaw_pose`, `left_hand_pose` … A file's
betas belong to its own model and its 10 expression coefficients to its own face: neither is applied. Files with
`arkit52` are captures in this project's layout: their 52 coefficients and their exact path are read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import require
from avatarrex.signals.driving import LARGEST
from avatarrex.signals.ground import grounded
from avatarrex.signals.joints import JOINT_ROWS
from avatarrex.signals.sequence import MOST_FRAMES, SignalSequence, check_frames, check_rate, stack

RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")
ROWS = {
    "pose_hand": slice(25, 55), **JOINT_ROWS, "root_orient": JOINT_ROWS["global_orient"], "pose_body": JOINT_ROWS["body_pose"],
    "pose_jaw": JOINT_ROWS["jaw_pose"], "pose_eye": JOINT_ROWS["eye_pose"],
}  # fmt: skip
"""Rows of the 55 rotation vectors by the key of a file by parts."""
KEYS = ("poses", "trans", "transl", "arkit52", "expression", *RATE_KEYS, *ROWS)
LARGEST_BYTES = 2 * 8 * MOST_FRAMES * 165
"""Of a file's arrays: twice what the longest motion's poses take in double precision."""
FASTEST = 15.0
"""Metres a second; sprinters reach 12."""
_SMPLH = [*range(22), *range(25, 55)]
"""SMPL+H lacks jaw and eyes."""


def read_smplx(path: str | Path) -> SignalSequence:
    """Read a motion of any of the three layouts. Raises `InputError` naming the key."""
    arrays = read_arrays(path, KEYS, LARGEST_BYTES)
    for key, value in arrays.items():
        check_frames(len(np.atleast_1d(value)), path, key)
        if value.dtype.kind not in "fiu":
            raise InputError(path, key, "numbers", value.dtype)
    check_magnitudes(arrays, path)
    rate, notes = _rate(arrays, path)
    full = _poses(arrays, path) if "poses" in arrays else _by_parts(arrays, path)
    translation = np.zeros((len(full), 3))
    for key in ("trans", "transl"):
        if key in arrays:
            translation = require(arrays, path, key, (len(full), 3)).astype(np.float64)
    notes.append("hands: full axis-angle as stored (flat_hand_mean=True)")
    if not full[:, 25:].any():
        notes.append("no finger moves: flat hands")
    expression = None
    if "arkit52" in arrays:
        expression = np.clip(require(arrays, path, "arkit52", (len(full), 52)).astype(np.float64), 0, 1)
        notes.append("a capture in our layout: path as stored")
    else:
        if "expression" in arrays:
            notes.append("the file's expression coefficients belong to another face: not applied")
        translation, more = _placed(full, translation)
        notes += more
    notes += _haste(translation, rate)
    return SignalSequence(stack(full, translation, expression), rate, Path(path).name, tuple(notes))


def _haste(translation: np.ndarray, rate: float) -> list[str]:
    """A note where the root goes faster than anybody runs: the path is then in another unit than metres."""
    speed = np.linalg.norm(np.diff(translation, axis=0), axis=1) * rate
    usual = float(np.quantile(speed, 0.9)) if len(speed) else 0.0
    if usual <= FASTEST:
        return []
    unit = "millimetres" if usual > 30 * FASTEST else "centimetres"
    return [f"the root goes at {usual:.0f} metres a second: the path looks like {unit}, it is taken as metres"]


def _rate(arrays: dict[str, np.ndarray], path: str | Path) -> tuple[float, list[str]]:
    for key in RATE_KEYS:
        if key in arrays:
            return check_rate(arrays[key], path, key), []
    return 30.0, ["no frame rate in the file: taken as 30 a second"]


def _poses(arrays: dict[str, np.ndarray], path: str | Path) -> np.ndarray:
    """(t, 55, 3) from `poses`."""
    poses = require(arrays, path, "poses", (None, None)).astype(np.float64)
    if poses.shape[1] not in (156, 165) or not len(poses):
        raise InputError(path, "poses", "shape (any, 156) SMPL+H or (any, 165) SMPL-X", poses.shape)
    full = np.zeros((len(poses), 55, 3))
    full[:, range(55) if poses.shape[1] == 165 else _SMPLH] = poses.reshape(len(poses), -1, 3)
    return full


def _by_parts(arrays: dict[str, np.ndarray], path: str | Path) -> np.ndarray:
    """(t, 55, 3) from one array per part; the body must be there."""
    body = next((key for key in ("body_pose", "pose_body") if key in arrays), None)
    if body is None:
        found = f"only {', '.join(sorted(arrays)[:12])}" if arrays else "none of a motion's keys"
        raise InputError(path, "poses", "poses, pose_body or body_pose", found)
    return joint_rotations(arrays, path, body)


def check_magnitudes(arrays: dict[str, np.ndarray], source: str | Path) -> None:
    """Raise `InputError` for rotations or a path beyond what `Signals` may be; what is not finite is refused by its reader."""
    for key, value in arrays.items():
        if key in ROWS or key in ("poses", "trans", "transl"):
            unit, name = ("metres", "translation") if key.startswith("trans") else ("radians", "body_pose")
            found = float(np.abs(value).max(initial=0))
            if LARGEST[name] < found < np.inf:
                raise InputError(source, key, f"{unit} up to {LARGEST[name]:g}", f"{found:g}")


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


def _placed(full: np.ndarray, translation: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Turn the axis along which the pelvis stands to +Y, start above the origin, put the lowest frame on the floor.

    `full` is changed in place. AMASS is Z-up, most other files are Y-up and cameras' worlds Y-down: the motion tells.
    """
    up = Rotation.from_rotvec(full[:, 0]).apply([0.0, 1.0, 0.0]).mean(0)
    axis = int(np.abs(up[1:]).argmax()) + 1
    turn, notes = Rotation.identity(), []
    if axis == 2 or up[1] < 0:
        # −90° about X takes +Z to +Y
        degrees = (-90.0 if up[2] > 0 else 90.0) if axis == 2 else 180.0
        turn = Rotation.from_euler("x", degrees, degrees=True)
        notes = [f"{'-' if up[axis] < 0 else ''}{'XYZ'[axis]}-up turned to Y-up"]
    full[:, 0] = (turn * Rotation.from_rotvec(full[:, 0])).as_rotvec()
    moved, floor_note = grounded(full, turn.apply(translation - translation[0]))
    return moved, [*notes, floor_note]
