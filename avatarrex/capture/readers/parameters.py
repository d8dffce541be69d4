"""What the captured person did: `smpl_params.npz` of a rig in our joints and coefficients. Letters: t frames.

SMPL-X order, rotation vectors, radians, metres; full axis-angle hands (no PCA), flat at zero unless the file says
otherwise; a hand without parameters is relaxed. `arkit52` (t, 52) with `arkit_names` are the expression, by name. `shape10` (10,) is the
default person's β, `betas` are SMPL-X's: each is applied to that person alone. `expression` (t, 10), SMPL-X's, is not applied.
`world_turn` (3,) is the rotation vector by which an import has turned the world about where neutral SMPL-X has its pelvis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.assets import require
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_ROWS
from avatarrex.signals.library import named_hand
from avatarrex.signals.sequence import MOST_FRAMES, SignalSequence, check_rate
from avatarrex.signals.smplx_npz import check_magnitudes, joint_rotations, rows

OTHERS = (
    "transl", "betas", "expression", "arkit52", "arkit_names", "shape10", "tpose_joints", "flat_hand_mean",
    "hands_meanl", "hands_meanr", "fps", "gender", "world_turn",
)  # fmt: skip
KEYS = (*JOINT_ROWS, *OTHERS)
TEXTS = ("arkit_names", "gender")
SEXES = ("neutral", "male", "female")
SHAPES = 10
"""Coefficients of a shape that are used."""
LARGEST_BYTES = 2 * 8 * MOST_FRAMES * (55 * 3 + 52)
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
    shapes: dict[str, np.ndarray]
    """β (10,) by whose directions it is in, as the file calls it."""
    joints: np.ndarray | None
    """(55, 3) of the T-pose, where the file has them."""
    fps: float
    sex: str
    """Of the model that `betas` are of, one of `SEXES`; empty where the file does not say."""
    turn: np.ndarray
    """(3, 3): `world_turn`."""
    notes: tuple[str, ...]

    def signals(self, shape: np.ndarray, shift: np.ndarray, scale: float, name: str) -> SignalSequence:
        """Our signals, of a shape (10,): translations times `scale`, plus `shift` (3,) where J_0 is elsewhere than our person's."""
        frames = (
            Signals.from_full_pose(pose, translation=translation * scale + shift, expression=expression, shape=shape)
            for pose, translation, expression in zip(self.pose, self.translation, self.expression)
        )
        return SignalSequence(tuple(frames), self.fps, name, self.notes)


def read_parameters(arrays: dict[str, np.ndarray], source: str) -> Parameters:
    """Check and convert a rig's arrays (those of `KEYS` it has). Raises `InputError` naming the key."""
    for key, value in arrays.items():
        if value.dtype.kind not in ("US" if key in TEXTS else "fiub"):
            raise InputError(source, key, "text" if key in TEXTS else "numbers", value.dtype)
    check_magnitudes({key: value for key, value in arrays.items() if key not in TEXTS}, source)
    notes: list[str] = []
    pose = _pose(arrays, source, notes)
    count = len(pose)
    expression = _expression(arrays, source, count, notes)
    shapes = _shapes(arrays, source, notes)
    joints = require(arrays, source, "tpose_joints", (55, 3)) if "tpose_joints" in arrays else None
    rate = check_rate(arrays.get("fps", 30.0), source)
    translation = rows(arrays, source, "transl", count, 3).astype(np.float64)
    turn = require(arrays, source, "world_turn", (3,)) if "world_turn" in arrays else np.zeros(3)
    return Parameters(
        pose, translation, expression, shapes, joints, rate, _sex(arrays), Rotation.from_rotvec(turn).as_matrix(), tuple(notes)
    )  # fmt: skip


def _sex(arrays: dict[str, np.ndarray]) -> str:
    """By the first letter of `gender`."""
    words = np.ravel(arrays.get("gender", "")).astype(str)
    word = words[0].strip().lower() if len(words) else ""
    return next((sex for sex in SEXES if word and sex[0] == word[0]), "")


def _shapes(arrays: dict[str, np.ndarray], source: str, notes: list[str]) -> dict[str, np.ndarray]:
    """By name. `betas` beside what says the size of another person are not this person's."""
    if "shape10" in arrays:
        return {"shape10": require(arrays, source, "shape10", (10,)).astype(np.float64)}
    if "betas" not in arrays or "tpose_joints" in arrays:
        return {}
    betas = np.atleast_2d(arrays["betas"]).astype(np.float64)
    if betas.ndim != 2 or not betas.size:
        raise InputError(source, "betas", "shape (coefficients) or (frames, coefficients)", arrays["betas"].shape)
    if np.ptp(betas, axis=0).max() > 0:
        notes.append("betas: another body in each frame: their median")
    shape = np.median(betas, axis=0)
    if shape[SHAPES:].any():
        notes.append(f"betas: {len(shape) - SHAPES} beyond the tenth are left out")
    return {"betas": np.pad(shape[:SHAPES], (0, max(0, SHAPES - len(shape))))}


def _pose(arrays: dict[str, np.ndarray], source: str, notes: list[str]) -> np.ndarray:
    """(t, 55, 3); joints without a key stay at rest."""
    for key in ("body_pose", "global_orient"):
        if key not in arrays or not np.ndim(arrays[key]):
            require(arrays, source, key, (None, None))
    pose = joint_rotations(arrays, source, "body_pose")
    given = [side for side in ("left", "right") if f"{side}_hand_pose" in arrays]
    free = [side for side in ("left", "right") if side not in given]
    for side in free:
        pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = named_hand("relaxed", side)
    if free:
        notes.append(
            f"hands: no {' and no '.join(f'{side}_hand_pose' for side in free)} in the file: relaxed in every frame"
        )
    flat = np.ravel(arrays.get("flat_hand_mean", True))
    if flat.size != 1:
        raise InputError(source, "flat_hand_mean", "one value", flat.shape)
    if given and not flat[0]:
        for side in given:
            mean = require(arrays, source, f"hands_mean{side[0]}", (45,))
            pose[:, JOINT_ROWS[f"{side}_hand_pose"]] += mean.reshape(15, 3)
        notes.append("hands: the file's mean pose added (flat_hand_mean=False)")
    return pose


def _expression(arrays: dict[str, np.ndarray], source: str, count: int, notes: list[str]) -> np.ndarray:
    """(t, 52) in our order, by name where the file has names."""
    result = np.zeros((count, 52))
    if "arkit52" not in arrays:
        if np.any(arrays.get("expression", 0)):
            notes.append("expression coefficients belong to the SMPL-X model: neutral face")
        return result
    names = [str(name) for name in np.ravel(arrays.get("arkit_names", EXPRESSION_NAMES))]
    values = rows(arrays, source, "arkit52", count, len(names))
    ours = {name.lower(): column for column, name in enumerate(EXPRESSION_NAMES)}
    columns = [ours.get(name.lower(), -1) for name in names]
    if min(columns, default=0) < 0 or len(set(columns)) != len(columns):
        wrong = next(name for k, name in enumerate(names) if columns[k] < 0 or columns[k] in columns[:k])
        raise InputError(source, "arkit_names", "each of Apple's blend shapes at most once", wrong)
    if values.min(initial=0) < -0.01 or values.max(initial=0) > 1.01:
        notes.append(f"expression from {values.min():.2f} to {values.max():.2f}: clamped to 0 … 1")
    result[:, columns] = np.clip(values, 0, 1)
    return result
