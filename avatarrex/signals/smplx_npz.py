"""SMPL-X and AMASS `.npz` motions (formats.md). A file's betas belong to its own model and are not applied."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.assets import read_arrays, require
from avatarrex.errors import InputError
from avatarrex.signals.sequence import SignalSequence, stack


def read_smplx(path: str | Path) -> SignalSequence:
    """Read AvatarReX-style (`body_pose` …) or AMASS-style (`poses`, Z up) arrays. Raises `InputError`."""
    arrays = read_arrays(path)
    rate = next((float(arrays[key]) for key in ("mocap_framerate", "mocap_frame_rate", "fps") if key in arrays), 30.0)
    if "poses" in arrays:
        poses = require(arrays, path, "poses", (None, None)).astype(np.float64)
        count = len(poses)
        if poses.shape[1] not in (156, 165):
            raise InputError(path, "poses", "156 (SMPL+H) or 165 (SMPL-X) columns", poses.shape[1])
        full = np.zeros((count, 55, 3))
        joints = poses.reshape(count, -1, 3)
        full[:, :22] = joints[:, :22]
        if joints.shape[1] == 55:
            full[:, 22:] = joints[:, 22:]
        else:
            full[:, 25:] = joints[:, 22:]
        translation = require(arrays, path, "trans", (count, 3)).astype(np.float64)
        to_ours = Rotation.from_euler("x", -90, degrees=True)
        full[:, 0] = (to_ours * Rotation.from_rotvec(full[:, 0])).as_rotvec()
        translation = to_ours.apply(translation - translation[0])
        return SignalSequence(
            stack(full, translation), rate, Path(path).name, ("Z-up turned to Y-up", "hands: flat_hand_mean as stored")
        )
    body = require(arrays, path, "body_pose", (None, 63)).astype(np.float64)
    count = len(body)
    full = np.zeros((count, 55, 3))
    full[:, 1:22] = body.reshape(count, 21, 3)

    def optional(key: str, width: int) -> np.ndarray:
        if key not in arrays:
            return np.zeros((count, width))
        return require(arrays, path, key, (count, width)).astype(np.float64)

    full[:, 0] = optional("global_orient", 3)
    full[:, 22] = optional("jaw_pose", 3)
    full[:, 25:40] = optional("left_hand_pose", 45).reshape(count, 15, 3)
    full[:, 40:55] = optional("right_hand_pose", 45).reshape(count, 15, 3)
    expression = optional("arkit52", 52) if "arkit52" in arrays else None
    notes = ("hands: full axis-angle, flat_hand_mean=True",)
    return SignalSequence(stack(full, optional("transl", 3), expression), rate, Path(path).name, notes)
