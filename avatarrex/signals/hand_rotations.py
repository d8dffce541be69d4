"""Fingers as rotation vectors with the flat hand at zero, of what SMPL-X's and MANO's files store of them. Letters: t frames.

Two flags decide what numbers mean, differ between sources, and are in no file for certain: `flat_hand_mean` (whether the mean hand is
still to be added) and PCA (coefficients of the model's components in place of angles). The file says them, or the user
(`ImportOptions.hand_mean`): `flat`, or a model file (`SMPLX_*.npz`, `MANO_*.pkl`) that has the mean and the components.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import numbers, require
from avatarrex.files.pickles import read_pickle
from avatarrex.signals.driving import LARGEST
from avatarrex.signals.import_options import SIDES, ImportOptions
from avatarrex.signals.imported import Guess
from avatarrex.signals.motion_keys import POSES

FLAGS = (
    "flat_hand_mean", "hands_mean", "hands_meanl", "hands_meanr", "hands_components", "hands_componentsl", "hands_componentsr",
)  # fmt: skip
"""Keys of a file or model."""
UNSIDED = ("hands_mean", "hands_components")
"""MANO's, of one hand; SMPL-X's end in the side's letter."""
SIDES_OF_NAMES = re.compile(r"(?<![a-z])(?:left|right)(?![a-z])")
"""Whose hand a model is of: `mano_right`."""
REMEDY = "--hand-mean flat, or --hand-mean with the model file that has it"
COLUMNS = 45
"""Columns: 15 joints of one hand."""
WITH_HANDS = (156, 165)
"""Columns of SMPL-H and SMPL-X, whose last are the hands."""
LARGEST_MODEL = 2**30
"""Bytes."""


@dataclass(frozen=True)
class Convention:
    """What a file's numbers of fingers mean."""

    flat: bool | None
    """Whether zero is the flat hand, not the mean one; None where nobody says."""
    why: str
    model: dict[str, np.ndarray]
    """Means and components by SMPL-X's keys."""
    place: Path
    """The file that has them."""
    named: bool
    """Whether the user named that file."""

    def part(self, name: str, side: str, shape: tuple[int, ...]) -> np.ndarray:
        """One hand's of `UNSIDED`. Raises `InputError`."""
        key = name + side[0]
        if key not in self.model:
            raise InputError(self.place, key, f"it in the file, or {REMEDY}", ", ".join(self.model) or "none")
        return numbers(require(self.model, self.place, key, shape), self.place, key, LARGEST["left_hand_pose"])


@dataclass(frozen=True)
class Fingers:
    """One hand's."""

    pose: np.ndarray
    """(t, 15, 3), in SMPL-X's order."""
    how: str
    """What was made of the numbers."""
    modelled: bool
    """Whether mean or components of the model are in them."""


def convention_of(
    flags: Mapping[str, np.ndarray], hands: tuple[str, ...], path: Path, options: ImportOptions
) -> Convention:
    """Of a motion file with `flags` (by `FLAGS`) and these hands: what was chosen, else what the file says. Raises `InputError`.

    A model that is named gives mean and components; whether the mean is to be added the file's own flag says; without one it is.
    """
    if options.hand_mean == "flat":
        return Convention(True, "chosen", _sided(flags, hands), path, False)
    flat = _flag(flags["flat_hand_mean"], path) if "flat_hand_mean" in flags else None
    why = "flat_hand_mean of the file"
    if not options.hand_mean:
        return Convention(flat, why, _sided(flags, hands), path, False)
    model = Path(options.hand_mean)
    said = SIDES_OF_NAMES.findall(model.stem.lower())
    arrays = _sided(_model(model), tuple(said) or hands)
    return Convention(bool(flat), "chosen" if flat is None else f"{why}, chosen model", arrays, model, True)


def fingers(values: np.ndarray, side: str, convention: Convention) -> Fingers:
    """Of (t, 45) angles or (t, n) coefficients, 0 < n < 45. Raises `InputError` where mean or components are needed and not there."""
    count = values.shape[1]
    found, how = values.astype(np.float64), "angles"
    if count < COLUMNS:
        found = found @ convention.part("hands_components", side, (COLUMNS, COLUMNS))[:count]
        how = f"{count} PCA coefficients"
    if not convention.flat:
        found = found + convention.part("hands_mean", side, (COLUMNS,))
    zero = "flat hand at zero" if convention.flat else "mean hand added"
    return Fingers(found.reshape(-1, 15, 3), f"{how}, {zero}", count < COLUMNS or not convention.flat)


def guess_of(what: str, read: list[Fingers], convention: Convention) -> Guess:
    """How fingers were read; it names the option unless a model was named that none of them needs."""
    heeded = not convention.named or any(one.modelled for one in read)
    how = " and ".join(dict.fromkeys(one.how for one in read)) or "not read"
    return Guess(what, how, convention.why, "hand_mean" if heeded else "")


def hands_of(
    arrays: dict[str, np.ndarray], flags: Mapping[str, np.ndarray], path: Path, options: ImportOptions
) -> tuple[Guess, list[str]]:
    """Make the hands of a body's arrays flat at zero, in place; what they were, and a warning of those that cannot be read, which are
    taken out. Where nobody says otherwise full angles are those of the flat hand. Raises `InputError`.

    `arrays` have all joints in one, one of `POSES`, or the body's parts.
    """
    blocks = _blocks(arrays)
    if not blocks:
        return Guess("hands", "none in the file"), []
    hands = tuple(dict.fromkeys(side for _, sides, _ in blocks for side in sides))
    convention, warnings, read = convention_of(flags, hands, path, options), list[str](), list[Fingers]()
    said = convention.flat is not None
    if not said:
        convention = replace(convention, flat=True, why="the file does not say otherwise")
    for key, sides, front in blocks:
        body, both = np.split(require(arrays, path, key, (None, None)), [front], 1)
        count = both.shape[1]
        if count < COLUMNS * len(sides) and not (said and f"hands_components{sides[0][0]}" in convention.model):
            del arrays[key]
            text = f"{key}: {count} PCA coefficients of another hand, not read"
            warnings.append(f"{text}: --hand-mean with the model file, or full axis-angle (PCA off)")
            continue
        found = [fingers(part, side, convention) for side, part in zip(sides, np.split(both, len(sides), 1))]
        arrays[key] = np.concatenate([body, *(one.pose.reshape(len(body), COLUMNS) for one in found)], 1)
        read += found
    return guess_of("hands", read, convention), warnings


def arrays_of(data: Mapping[Any, Any], keys: tuple[str, ...], path: Path) -> dict[str, np.ndarray]:
    """Arrays of a pickle's dictionary, of those `keys` that it has. Raises `InputError`."""
    found = dict[str, np.ndarray]()
    for key in (key for key in keys if key in data):
        try:
            found[key] = np.asarray(data[key])
        except ValueError as error:  # rows of different lengths
            raise InputError(path, key, "an array", error) from None
    return found


def _blocks(arrays: Mapping[str, np.ndarray]) -> list[tuple[str, tuple[str, ...], int]]:
    """Keys of arrays with hands, whose they are, and the columns before them."""
    widths = {key: value.shape[1] for key, value in arrays.items() if value.ndim == 2}
    whole = next((key for key in POSES if key in arrays), None)
    if whole is not None:
        return [(whole, SIDES, widths[whole] - 2 * COLUMNS)] if widths.get(whole) in WITH_HANDS else []
    parts = {"pose_hand": SIDES, "left_hand_pose": SIDES[:1], "right_hand_pose": SIDES[1:]}
    return [
        (key, parts[key], 0)
        for key, width in widths.items()
        if key in parts and 0 < width <= COLUMNS * len(parts[key]) and width % len(parts[key]) == 0
    ]


def _sided(arrays: Mapping[str, np.ndarray], hands: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Means and components by SMPL-X's keys; MANO's are of the one hand in `hands`, of two nobody knows whose they are."""
    found = {key: arrays[key] for key in FLAGS[1:] if key in arrays}
    if len(hands) == 1:
        for name in UNSIDED:
            if name in found:
                found.setdefault(name + hands[0][0], found.pop(name))
    return found


def _flag(value: np.ndarray, path: Path) -> bool:
    """Raises `InputError`."""
    if value.dtype.kind not in "biuf" or not value.size or not ((value == 0).all() or (value == 1).all()):
        raise InputError(path, "flat_hand_mean", "true or false, or 1 or 0", str(value.tolist())[:60])
    return bool(value.flat[0])


def _model(path: Path) -> dict[str, np.ndarray]:
    """Mean and components of a model file. Raises `InputError`."""
    if path.suffix.lower() == ".npz":
        found = read_arrays(path, FLAGS[1:], LARGEST_MODEL)
    else:
        data = read_pickle(path, "a hand model")
        found = arrays_of(data, FLAGS[1:], path) if isinstance(data, dict) else {}
    if not found:
        raise InputError(path, "hands_mean", "a model file with it (SMPLX_*.npz, MANO_*.pkl)", "none")
    return found
