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
from avatarrex.capture.readers.undistort import straighten
from avatarrex.errors import InputError, check
from avatarrex.files.assets import require
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.sequence import MOST_FRAMES

FILE = "keypoints.npz"
KEYS = ("names", "cameras", "points", "confidence")
LARGEST_BYTES = 2**31
"""Of the arrays: 55 joints of 16 cameras in 50 000 frames take half of that in single precision."""
FARTHEST = 1e6
"""Pixels from a picture's corner that a point may be."""


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
    check(count <= MOST_FRAMES, place, "points", f"at most {MOST_FRAMES} frames", count)
    confidence = require(arrays, place, "confidence", shape)
    check(
        confidence.dtype.kind in "fiu" and confidence.min(initial=0) >= 0 and confidence.max(initial=0) <= 1,
        place, "confidence", "numbers from 0 to 1", confidence.dtype if confidence.dtype.kind not in "fiu" else
        f"{confidence.min(initial=0):g} to {confidence.max(initial=0):g}",
    )  # fmt: skip
    seen = confidence > 0
    points = np.where(seen[..., None], _points(arrays, place, (*shape, 2)), 0).astype(np.float64)
    wild = ~np.isfinite(points) | (np.abs(np.nan_to_num(points)) > FARTHEST)
    check(
        not wild.any(),
        place,
        "points",
        f"pixels within {FARTHEST:g} where confidence is above 0",
        f"{wild.sum()} others",
    )
    ordered = np.zeros((count, len(lenses), len(names), 2)), np.zeros((count, len(lenses), len(names)))
    for view, lens in enumerate(lenses):
        if lens.name in cameras:
            column = cameras.index(lens.name)
            ordered[0][:, view] = straighten(lens, points[:, column])
            ordered[1][:, view] = confidence[:, column]
    return Keypoints(tuple(map(JOINT_NAMES.index, names)), *ordered)


def _words(arrays: dict[str, np.ndarray], place: str, key: str) -> list[str]:
    check(key in arrays, place, key, "the key to be there", f"only {', '.join(sorted(arrays))}")
    found = arrays[key]
    check(found.ndim == 1 and found.dtype.kind in "US", place, key, "a row of words", f"{found.shape} of {found.dtype}")
    return [word.decode(errors="replace") if isinstance(word, bytes) else str(word) for word in found]


def _points(arrays: dict[str, np.ndarray], place: str, shape: tuple[int, ...]) -> np.ndarray:
    """Not yet judged: what was not seen may be NaN."""
    found = arrays.get("points")
    if found is None or found.shape != shape or found.dtype.kind not in "fiu":
        raise InputError(
            place, "points", f"numbers of shape {shape}", "none" if found is None else f"{found.shape} of {found.dtype}"
        )
    return found
