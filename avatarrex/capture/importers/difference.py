"""Mattes from a picture of the empty scene: what differs from it, in one piece, without holes; and how good any matte is.

d = max over channels of |image − backdrop|; foreground from `CLEAR` times the noise on; in its rim, two pixels wide, the share is d over
that of the foreground. Exposure that has changed between the two is undone by the median ratio of their colours. Letters: h w pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

CLEAR, FULL = 6.0, 0.9
"""Standard deviations of the pictures' noise from which on something differs; share of the foreground's median difference that is whole."""
HOLE = 0.003
"""Of the person's area: holes below it are the person, too."""
LEAST_NOISE = 2.0
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
    lit = (empty > 16) & (empty < 240)
    ratio = [
        float(np.median(seen[..., c][lit[..., c]] / empty[..., c][lit[..., c]])) if lit[..., c].any() else 1.0
        for c in range(3)
    ]
    away = np.abs(seen - empty * np.clip(ratio, 0.5, 2.0)).max(2)
    noise = max(1.4826 * float(np.median(away)), LEAST_NOISE)
    smooth = ndimage.gaussian_filter(away, 0.7)
    whole = _filled(largest_pieces(ndimage.binary_opening(smooth > CLEAR * noise)))
    if not whole.any():
        return np.zeros(whole.shape, np.uint8)
    share = np.clip(away / (FULL * np.median(away[whole])), 0, 1)
    near, inner = ndimage.binary_dilation(whole), ndimage.binary_erosion(whole)
    return np.asarray(np.rint(255 * np.where(inner, 1.0, np.where(near, share, 0.0))), np.uint8)


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
