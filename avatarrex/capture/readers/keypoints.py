"""Where joints were detected in the pictures of a rig: `keypoints.npz`, 2D, with a confidence, per frame and camera.

| array | shape | |
|---|---|---|
| `names` | (k,) text | SMPL-X joints (`signals/joints.py`), each at most once |
| `cameras` | (c,) text | of the calibration, each at most once |
| `points` | (t, c, k, 2) | column and row in the picture as taken, lens included; pixel centres at +0.5 |
| `confidence` | (t, c, k) | 0 (not seen; the point is then not read) to 1 |

Letters: t frames, c cameras, k keypoints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.layout import RigFiles
from avatarrex.capture.readers.undistort import bend, straighten
from avatarrex.errors import InputError, check
from avatarrex.signals.joints import JOINT_NAMES

FILE = "keypoints.npz"
KEYS = ("names", "cameras", "points", "confidence")
LARGEST_BYTES = 2**31
"""Of the arrays: 55 joints of 16 cameras in 50 000 frames take half of that in single precision."""
FARTHEST = 1e5
"""Pixels from a picture's corner that a point may be."""
STRAIGHT = 0.5
"""Pixels within which the lens has to lead back to a point; one that it cannot have shown was not seen."""


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Of all cameras of a rig."""

    joints: tuple[int, ...]
    """(k) rows of `JOINT_NAMES`."""
    points: np.ndarray
    """(t, c, k, 2) pixels of the ideal pinhole, cameras as the rig has them."""
    confidence: np.ndarray
    """(t, c, k)."""

    def at(self, view: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (k, 2) and confidence (k,) of a picture."""
        return self.points[frame, view], self.confidence[frame, view]


def read_keypoints(
    files: RigFiles, lenses: tuple[Lens, ...], calibrated: tuple[str, ...], count: int
) -> Keypoints | None:
    """Of the cameras `lenses` among those `calibrated`, in `count` frames; None without the file. Raises `InputError`."""
    archive, name = files.archive, files.name(FILE)
    if not archive.exists(name):
        return None
    place = archive.place(name)
    arrays = archive.arrays(name, KEYS, LARGEST_BYTES)
    names, cameras = (_words(arrays, place, key) for key in ("names", "cameras"))
    for key, words, known in (("names", names, JOINT_NAMES), ("cameras", cameras, calibrated)):
        wrong = next((word for k, word in enumerate(words) if word not in known or word in words[:k]), None)
        check(wrong is None, place, key, f"each at most once of {', '.join(known[:6])}, …", wrong)
    shape = (count, len(cameras), len(names))
    confidence = _numbers(arrays, place, "confidence", shape)
    low, high = (confidence.min(), confidence.max()) if confidence.size else (0, 0)
    check(low >= 0 and high <= 1, place, "confidence", "numbers from 0 to 1", f"{low:g} to {high:g}")
    points = np.where(confidence[..., None] > 0, _numbers(arrays, place, "points", (*shape, 2)), 0)
    wild = int((~(np.abs(points) < FARTHEST)).sum())
    check(not wild, place, "points", f"pixels within {FARTHEST:g} where confidence is above 0", f"{wild} others")
    ordered, sure = np.zeros((count, len(lenses), len(names), 2)), np.zeros((count, len(lenses), len(names)))
    for view, lens in enumerate(lenses):
        if lens.name in cameras:
            taken = points[:, cameras.index(lens.name)]
            ideal = straighten(lens, taken)
            found = np.isfinite(ideal).all(-1) & (np.abs(bend(lens, np.nan_to_num(ideal)) - taken) < STRAIGHT).all(-1)
            ordered[:, view] = np.where(found[..., None], ideal, 0)
            sure[:, view] = np.where(found, confidence[:, cameras.index(lens.name)], 0)
    return Keypoints(tuple(map(JOINT_NAMES.index, names)), ordered, sure)


def _words(arrays: dict[str, np.ndarray], place: str, key: str) -> list[str]:
    check(key in arrays, place, key, "the key to be there", f"only {', '.join(sorted(arrays))}")
    found = arrays[key]
    check(found.ndim == 1 and found.dtype.kind in "US", place, key, "a row of words", f"{found.shape} of {found.dtype}")
    return [word.decode(errors="replace") if isinstance(word, bytes) else str(word) for word in found]


def _numbers(arrays: dict[str, np.ndarray], place: str, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """float64, perhaps NaN: points that were not seen may be."""
    found = arrays.get(key)
    if found is None or found.shape != shape or found.dtype.kind not in "fiu":
        other = "none" if found is None else f"{found.shape} of {found.dtype}"
        raise InputError(place, key, f"numbers of shape {shape}", other)
    return found.astype(np.float64)
