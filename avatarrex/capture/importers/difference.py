"""Mattes from a picture of the empty scene: what differs from it, in one piece, without holes; and how good any matte is.

z = (image − backdrop) / σ by channel, σ the pictures' noise; foreground where |z| is above `CLEAR`, but for single pixels. In its rim the
share is |z| over that of the nearest pixel well within. Exposure that has changed between the two pictures is undone by the median ratio
of their colours. Letters: h w pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

CLEAR = 5.0
"""|z| from which on something differs: of noise alone a hundred-thousandth of the pixels is above."""
RIM = 2
"""Pixels from the edge inwards that may be mixed."""
SPARSE, ROUNDS = 3, 5
"""Every so many rows and columns are measured for how bright and how noisy the empty scene is; rounds in which the person is told from it."""
HOLE = 0.003
"""Of the person's area: holes below it are the person, too."""
LEAST_NOISE = 1.5
"""Of 255: JPEG's own."""
SMALL = 0.02
"""Share of the largest piece below which another one is not the person."""
LITTLE, MUCH, EDGE, PIECES = 0.002, 0.8, 0.02, 3
"""A matte is doubtful that covers less or more of the picture, more of its border, or consists of more pieces."""


@dataclass(frozen=True)
class MatteQuality:
    """Of one matte."""

    coverage: float
    """Share of the picture that it covers."""
    border: float
    """Share of the picture's border that it covers."""
    pieces: int
    """Of more than a fiftieth of the largest."""
    soft: float
    """Share of its pixels that are neither foreground nor background."""

    def faults(self) -> list[str]:
        """What is doubtful, one phrase each."""
        found = []
        if not LITTLE < self.coverage < MUCH:
            found.append(f"covers {self.coverage:.1%} of the picture")
        if self.border > EDGE:
            found.append(f"covers {self.border:.0%} of the picture's border")
        if self.pieces > PIECES:
            found.append(f"is in {self.pieces} pieces")
        return found


def difference_matte(image: np.ndarray, backdrop: np.ndarray) -> np.ndarray:
    """(h, w) bytes, from sRGB bytes (h, w, 3) of the picture and of the empty scene."""
    seen, empty = image.astype(np.float32), backdrop.astype(np.float32)
    ratio, noise = _exposure_and_noise(
        seen[::SPARSE, ::SPARSE].reshape(-1, 3), empty[::SPARSE, ::SPARSE].reshape(-1, 3)
    )
    away = np.linalg.norm((seen - empty * ratio) / noise, axis=2)
    whole = _filled(largest_pieces(ndimage.binary_opening(away > CLEAR)))
    if not whole.any():
        return np.zeros(whole.shape, np.uint8)
    inner, near = ndimage.binary_erosion(whole, iterations=RIM), ndimage.binary_dilation(whole)
    rows, columns = ndimage.distance_transform_edt(~inner, return_distances=False, return_indices=True)
    share = away / np.maximum(away[rows, columns], CLEAR) if inner.any() else whole
    return np.asarray(np.rint(255 * np.where(near & ~inner, np.clip(share, 0, 1), inner)), np.uint8)


def _exposure_and_noise(seen: np.ndarray, empty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) ratio of the pictures' colours (p, 3), and (3,) standard deviation of what is left, of the pixels that show the empty scene."""
    same, ratio, noise = np.ones(len(seen), bool), np.ones(3), np.ones(3)
    for _ in range(ROUNDS):
        for c in range(3):
            lit = same & (empty[:, c] > 16) & (empty[:, c] < 240)
            ratio[c] = np.clip(np.median(seen[lit, c] / empty[lit, c]), 0.5, 2.0) if lit.any() else 1.0
        off = seen - empty * ratio
        noise = np.maximum(1.4826 * np.median(np.abs(off[same]), 0), LEAST_NOISE)
        same = np.linalg.norm(off / noise, axis=1) < CLEAR
        if not same.any():
            break
    return ratio, noise


def _filled(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool without small holes; what is between an arm and the body stays open."""
    labels, _ = ndimage.label(~mask)
    area = np.bincount(labels.ravel())
    return np.asarray(mask | (area < HOLE * mask.sum())[labels])


def largest_pieces(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool without pieces below `SMALL` of the largest."""
    labels, count = ndimage.label(mask)
    if not count:
        return mask
    area = np.bincount(labels.ravel())
    area[0] = 0
    return np.asarray((area >= SMALL * area.max())[labels] & mask)


def quality(matte: np.ndarray) -> MatteQuality:
    """Of a matte (h, w), bytes."""
    inside = matte > 127
    border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    soft = float(((matte > 25) & (matte < 230)).sum() / max(int((matte > 25).sum()), 1))
    return MatteQuality(float(inside.mean()), float(border.mean()), int(ndimage.label(largest_pieces(inside))[1]), soft)
