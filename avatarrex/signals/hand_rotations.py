"""Fingers as rotation vectors with the flat hand at zero, of what SMPL-X's and MANO's files store of them. Letters: t frames.

Two flags decide what numbers mean, differ between sources, and are in no file for certain: `flat_hand_mean` (whether the mean hand is
still to be added) and PCA (coefficients of the model's components in place of angles). They are taken from the file or chosen
(`ImportOptions.hand_mean`): `flat`, or a model file (`SMPLX_*.npz`, `MANO_*.pkl`) that has the mean and the components.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.pickles import read_pickle
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess

FLAGS = (
    "flat_hand_mean", "hands_mean", "hands_meanl", "hands_meanr", "hands_components", "hands_componentsl", "hands_componentsr",
)  # fmt: skip
"""Keys of a file or model."""
REMEDY = "--hand-mean flat, or --hand-mean with the model file that has it"
LARGEST_MODEL = 2**30
"""Bytes."""


@dataclass(frozen=True)
class Fingers:
    """One hand's."""

    pose: np.ndarray
    """(t, 15, 3), in SMPL-X's order."""
    how: str
    """What was made of the numbers."""
    why: str


def fingers(
    values: np.ndarray, side: str, arrays: Mapping[str, np.ndarray], path: Path, options: ImportOptions
) -> Fingers | None:
    """Of (t, 45) angles or (t, n) coefficients, n < 45; `arrays` are the file's. None where nobody says whether the mean hand is in them.

    Raises `InputError` where mean or components are needed and not there.
    """
    model = dict(arrays)
    why = "flat_hand_mean of the file"
    flat: bool | None = (
        bool(np.ravel(arrays["flat_hand_mean"])[0]) if np.size(arrays.get("flat_hand_mean", ())) else None
    )
    if options.hand_mean:
        flat, why = options.hand_mean == "flat", "chosen"
        model |= {} if flat else _model(Path(options.hand_mean))
    found, how = values.astype(np.float64), "angles"
    if values.shape[1] < 45:
        components = _part(model, "hands_components", side, (45, 45), path)
        found, how = found @ components[: values.shape[1]], f"{values.shape[1]} PCA coefficients"
    if flat is None:
        return None
    if not flat:
        found = found + _part(model, "hands_mean", side, (45,), path)
    return Fingers(found.reshape(-1, 15, 3), f"{how}, {'flat hand at zero' if flat else 'mean hand added'}", why)


def hands_of(
    arrays: dict[str, np.ndarray], flags: Mapping[str, np.ndarray], path: Path, options: ImportOptions
) -> tuple[Guess, list[str]]:
    """Make the hands of a body's arrays flat at zero, in place; what they were, and a warning of those that cannot be read, which are
    taken out. Where nobody says otherwise full angles are those of the flat hand. Raises `InputError`."""
    said, warnings = Guess("hands", "angles, flat hand at zero", "the file does not say otherwise", "hand_mean"), []
    for key, width in (("pose_hand", 90), ("left_hand_pose", 45), ("right_hand_pose", 45)):
        value = arrays.get(key)
        if value is None or value.ndim != 2 or not 0 < value.shape[1] <= width:
            continue
        known = options.hand_mean not in ("", "flat") or "hands_componentsl" in flags
        stated = bool(options.hand_mean) or "flat_hand_mean" in flags
        if value.shape[1] < width and not (stated and known):
            del arrays[key]
            count = f"{value.shape[1]} PCA coefficients of another hand, not read"
            warnings.append(f"{key}: {count}: --hand-mean with the model file, or full axis-angle (PCA off)")
        elif stated:
            half = value.shape[1] // 2
            both = {"left": value[:, :half], "right": value[:, half:]}
            parts = both if key == "pose_hand" else {key.partition("_")[0]: value}
            read = [fingers(part, side, flags, path, options) for side, part in parts.items()]
            found = [one for one in read if one is not None]
            arrays[key] = np.concatenate([one.pose.reshape(len(value), -1) for one in found], 1)
            said = Guess("hands", found[0].how, found[0].why, "hand_mean")
    return said, warnings


def _part(model: Mapping[str, np.ndarray], name: str, side: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """Of SMPL-X by the side's letter, of MANO without. Raises `InputError`."""
    value = next((model[key] for key in (name + side[0], name) if key in model), None)
    if value is None:
        raise InputError(path, name + side[0], f"it in the file, or {REMEDY}", "none")
    array = np.asarray(value)
    if array.shape != shape or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise InputError(path, name, f"numbers of shape {shape}", f"{array.shape} of {array.dtype}")
    return array.astype(np.float64)


def _model(path: Path) -> dict[str, np.ndarray]:
    """Mean and components of a model file. Raises `InputError`."""
    if path.suffix.lower() == ".npz":
        found = read_arrays(path, FLAGS[1:], LARGEST_MODEL)
    else:
        data = read_pickle(path, "a hand model")
        found = {key: np.asarray(data[key]) for key in FLAGS[1:] if key in data} if isinstance(data, dict) else {}
    if not found:
        raise InputError(path, "hands_mean", "a model file with it (SMPLX_*.npz, MANO_*.pkl)", "none")
    return found
