"""What the captured person did: `smpl_params.npz` of a rig in our joints and coefficients. Letters: t frames.

SMPL-X order, rotation vectors, radians, metres; full axis-angle hands (no PCA), flat at zero unless the file says
otherwise. `arkit52` (t, 52) with `arkit_names` are the expression, by name; `shape10` (10,) is this project's own β.
`betas` and `expression` (t, 10) belong to the SMPL-X model and are not applied to another person.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.assets import require
from avatarrex.signals.driving import LARGEST, Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.sequence import FRAMES, SignalSequence, check_frames

PARTS: dict[str, tuple[int, int]] = {
    "global_orient": (0, 1), "body_pose": (1, 22), "jaw_pose": (22, 23), "eye_pose": (23, 25), "leye_pose": (23, 24),
    "reye_pose": (24, 25), "left_hand_pose": (25, 40), "right_hand_pose": (40, 55),
}  # fmt: skip
"""Joints (first, end) of each key; the first two must be there."""
OTHERS = (
    "transl", "betas", "expression", "arkit52", "arkit_names", "shape10", "tpose_joints", "flat_hand_mean",
    "hands_meanl", "hands_meanr", "fps",
)  # fmt: skip
KEYS = (*PARTS, *OTHERS)
LARGEST_BYTES = 2 * 8 * FRAMES * (55 * 3 + 52)
"""Of the arrays: twice what the longest capture's pose and expression take in double precision."""


@dataclass(frozen=True)
class Parameters:
    """A rig's parameters, as the file means them."""

    pose: np.ndarray
    """(t, 55, 3) rotation vectors."""
    translation: np.ndarray
    """(t, 3): the pelvis is at J_0 + translation."""
    expression: np.ndarray
    """(t, 52) in our order."""
    shape: np.ndarray | None
    """(10,) where the person is this project's own."""
    joints: np.ndarray | None
    """(55, 3) of the T-pose, where the file has them."""
    fps: float
    notes: tuple[str, ...]

    def signals(self, shift: np.ndarray, scale: float, name: str) -> SignalSequence:
        """Our signals: translations times `scale`, plus `shift` (3,) where J_0 is elsewhere than our person's."""
        shape = np.zeros(10) if self.shape is None else self.shape
        frames = (
            Signals.from_full_pose(pose, translation=translation * scale + shift, expression=expression, shape=shape)
            for pose, translation, expression in zip(self.pose, self.translation, self.expression)
        )
        return SignalSequence(tuple(frames), self.fps, name, self.notes)


def read_parameters(arrays: dict[str, np.ndarray], source: str) -> Parameters:
    """Check and convert a rig's arrays (those of `KEYS` it has). Raises `InputError` naming the key."""
    for key, value in arrays.items():
        if value.dtype.kind not in ("US" if key == "arkit_names" else "fiub"):
            raise InputError(source, key, "text" if key == "arkit_names" else "numbers", value.dtype)
        largest = LARGEST["translation" if key == "transl" else "body_pose"]
        if (key in PARTS or key == "transl") and not (np.abs(value) <= largest).all() and np.isfinite(value).all():
            raise InputError(source, key, f"numbers up to {largest:g}", f"{np.abs(value).max():g}")
    notes: list[str] = []
    pose = _pose(arrays, source, notes)
    count = len(pose)
    expression = _expression(arrays, source, count, notes)
    shape = require(arrays, source, "shape10", (10,)).astype(np.float64) if "shape10" in arrays else None
    joints = require(arrays, source, "tpose_joints", (55, 3)) if "tpose_joints" in arrays else None
    if shape is None and np.any(arrays.get("betas", 0)):
        notes.append("betas belong to the SMPL-X model: not applied")
    rate = np.ravel(arrays.get("fps", 30.0))
    if rate.size != 1 or not 0 < rate[0] <= 1000:
        raise InputError(source, "fps", "one rate above 0, at most 1000", rate.tolist())
    translation = _rows(arrays, source, "transl", count, 3).astype(np.float64)
    return Parameters(pose, translation, expression, shape, joints, float(rate[0]), tuple(notes))


def _pose(arrays: dict[str, np.ndarray], source: str, notes: list[str]) -> np.ndarray:
    """(t, 55, 3); joints without a key stay at rest."""
    body = arrays.get("body_pose", np.zeros(0))
    if not body.size or not body.ndim:
        _rows(arrays, source, "body_pose", 0, 63)
        raise InputError(source, "body_pose", "at least one frame", 0)
    count = len(require(arrays, source, "body_pose", (None,) * body.ndim))
    check_frames(count, source, "body_pose")
    require(arrays, source, "global_orient", (None,) * np.ndim(arrays.get("global_orient", 0)))
    pose = np.zeros((count, 55, 3))
    for key, (first, end) in PARTS.items():
        if key in arrays:
            pose[:, first:end] = _rows(arrays, source, key, count, 3 * (end - first)).reshape(count, -1, 3)
    flat = np.ravel(arrays.get("flat_hand_mean", True))
    if flat.size != 1:
        raise InputError(source, "flat_hand_mean", "one value", flat.shape)
    if not flat[0]:
        for key, part in (("hands_meanl", slice(25, 40)), ("hands_meanr", slice(40, 55))):
            pose[:, part] += require(arrays, source, key, (45,)).reshape(15, 3)
        notes.append("hands: the file's mean pose added (flat_hand_mean=False)")
    return pose


def _rows(arrays: dict[str, np.ndarray], source: str, key: str, count: int, width: int) -> np.ndarray:
    """`arrays[key]` as (count, width), stored so or with its joints apart; hands of fewer columns are PCA."""
    value = arrays.get(key)
    if value is not None and value.ndim == 3 and value.shape[2] == 3:
        value = value.reshape(len(value), -1)
    rows = require({} if value is None else {**arrays, key: value}, source, key, (None, None))
    if "hand" in key and 0 < rows.shape[1] < width:
        raise InputError(source, key, f"{width} columns of axis-angle (PCA off)", f"{rows.shape[1]} columns")
    if rows.shape != (count, width):
        expected = f"shape ({count}, {width})" + (", as many frames as body_pose" if len(rows) != count else "")
        raise InputError(source, key, expected, rows.shape)
    return rows


def _expression(arrays: dict[str, np.ndarray], source: str, count: int, notes: list[str]) -> np.ndarray:
    """(t, 52) in our order, by name where the file has names."""
    result = np.zeros((count, 52))
    if "arkit52" not in arrays:
        if np.any(arrays.get("expression", 0)):
            notes.append("expression coefficients belong to the SMPL-X model: neutral face")
        return result
    names = [str(name) for name in np.ravel(arrays.get("arkit_names", EXPRESSION_NAMES))]
    values = _rows(arrays, source, "arkit52", count, len(names))
    ours = {name.lower(): column for column, name in enumerate(EXPRESSION_NAMES)}
    columns = [ours.get(name.lower(), -1) for name in names]
    if min(columns, default=0) < 0 or len(set(columns)) != len(columns):
        wrong = next(name for k, name in enumerate(names) if columns[k] < 0 or columns[k] in columns[:k])
        raise InputError(source, "arkit_names", "each of Apple's blend shapes at most once", wrong)
    if values.min(initial=0) < -0.01 or values.max(initial=0) > 1.01:
        notes.append(f"expression from {values.min():.2f} to {values.max():.2f}: clamped to 0 … 1")
    result[:, columns] = np.clip(values, 0, 1)
    return result
