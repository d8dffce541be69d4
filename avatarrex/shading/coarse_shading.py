"""Colours of pixels between pixels that are evaluated: the shading rate follows the picture's content.

Every second pixel of every second row is evaluated (a quarter: coarse pixel shading, Vaidyanathan and others 2014). A pixel between
them is interpolated where its neighbours are on the same sheet and the colours there are nearly linear (as in content-adaptive shading,
Yang and others 2019); where they are not it is evaluated, too.

A pixel in a row or column of evaluated ones lies on one line of four of them, 1 and 3 pixels away on both sides; one amid four
lies on two such lines, its diagonals. On a line colours are cubic (four-point scheme of Dubuc 1986). The error that is compared with
the tolerance is that of linear interpolation, an eighth of the second differences, and half of what two lines differ by.

Letters: h w pixels, k parts. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int, Shaped
from torch import Tensor

from avatarrex.ops import native
from avatarrex.ops.native import borrowing
from avatarrex.pointmap.point_map import PointMap

Array = Shaped[np.ndarray, "..."]

SAME_SHEET = np.float32(0.7)
"""Least cosine between the normals of a pixel and its neighbours."""
SAME_SHARE = np.float32(0.25)
"""Difference of a part's ω between them at most: it grows from 0 to 1 over two centimetres."""
AMID = np.float32(0.25)
"""Share of the distance between two neighbours by which a point may be off their middle: it is on another sheet, or at a fold."""
FEW = 16
"""Rows of a picture up to which one thread is done before others have started."""
ZERO, ONE, HALF, EIGHTH = np.float32(0), np.float32(1), np.float32(0.5), np.float32(0.125)
NINE, SIXTEENTH, FAR = np.float32(9), np.float32(1 / 16), np.float32(np.inf)


class Sheets(NamedTuple):
    """What lies in the pixels, as images."""

    position: Array
    """(h, w, 3)."""
    normal: Array
    """(h, w, 3)."""
    part_weight: Array
    """(h, w, k)."""
    side: Array
    """(h, w)."""
    whole: Array
    """(h, w) bool: covered, and met by the ray through the centre."""


def evaluated_first(wanted: Bool[Tensor, "h w"]) -> Bool[Tensor, "h w"]:
    """Those of the `wanted` pixels that others are interpolated between."""
    coarse = torch.zeros_like(wanted)
    coarse[::2, ::2] = wanted[::2, ::2]
    return coarse


def interpolate(
    image: Float32[Tensor, "h w 4"],
    wanted: Bool[Tensor, "h w"],
    pointmap: PointMap,
    side: Int[Tensor, "h w"] | None,
    tolerance: float,
    impl: str = "auto",
) -> Bool[Tensor, "h w"]:
    """Put into `image` the colours of `wanted` pixels that are within `tolerance` (sRGB), and say which those are.

    `image`: premultiplied; every covered pixel of an even row and column has its colour, and none of them is wanted. `side`: the limb
    that each is on; None: no limb touches another. `impl`: `auto`, `reference`.
    """
    whole = pointmap.hit & (pointmap.coverage == 1)
    side = torch.zeros_like(wanted, dtype=torch.int64) if side is None else side
    images = pointmap.position, pointmap.normal, pointmap.part_weight, side, whole
    sheets, told = Sheets(*(values.contiguous().numpy() for values in images)), torch.zeros_like(wanted)
    arrays = sheets, wanted.numpy(), np.float32(tolerance), image.numpy(), told.numpy()
    if impl == "reference":
        _reference(*arrays)
    else:
        native.spread(_interpolate, len(wanted), *arrays, few=FEW)
    return told


@borrowing
def _alike(sheets: Sheets, row: int, column: int, other: int, across: int) -> bool:
    """Whether pixel (other, across) is in the picture and on the sheet of (row, column)."""
    height, width = sheets.side.shape
    if not (0 <= other < height and 0 <= across < width and sheets.whole[other, across]):
        return False
    if sheets.side[other, across] != sheets.side[row, column]:
        return False
    for part in range(sheets.part_weight.shape[2]):
        if abs(sheets.part_weight[other, across, part] - sheets.part_weight[row, column, part]) > SAME_SHARE:
            return False
    along = ZERO
    for axis in range(3):
        along += sheets.normal[other, across, axis] * sheets.normal[row, column, axis]
    return bool(along >= SAME_SHEET)


@borrowing
def _amid(sheets: Sheets, row: int, column: int, down: int, right: int) -> bool:
    """Whether the point of the pixel lies between those of its neighbours on the line along (down, right)."""
    off = gap = ZERO
    for axis in range(3):
        one = sheets.position[row - down, column - right, axis]
        other = sheets.position[row + down, column + right, axis]
        middle = sheets.position[row, column, axis] - HALF * (one + other)
        off += middle * middle
        gap += (other - one) * (other - one)
    return bool(off <= AMID * AMID * gap)


@borrowing
def _error(sheets: Sheets, image: Array, row: int, column: int, down: int, right: int) -> np.float32:
    """Of interpolation along (down, right), in the worst channel; infinite where the four pixels are on other sheets."""
    for step in (-1, 1, -3, 3):
        if not _alike(sheets, row, column, row + step * down, column + step * right):
            return FAR
    if not _amid(sheets, row, column, down, right):
        return FAR
    worst = ZERO
    for channel in range(3):
        first = image[row - 3 * down, column - 3 * right, channel]
        one, other = image[row - down, column - right, channel], image[row + down, column + right, channel]
        last = image[row + 3 * down, column + 3 * right, channel]
        worst = max(worst, abs(first - one - one + other), abs(one - other - other + last))
    return EIGHTH * worst


@borrowing
def _cubic(image: Array, row: int, column: int, down: int, right: int, channel: int) -> np.float32:
    near = image[row - down, column - right, channel] + image[row + down, column + right, channel]
    far = image[row - 3 * down, column - 3 * right, channel] + image[row + 3 * down, column + 3 * right, channel]
    return np.float32(SIXTEENTH * (NINE * near - far))


@native.native
def _interpolate(
    begin: int, end: int, sheets: Sheets, wanted: Array, tolerance: np.float32, image: Array, told: Array
) -> None:
    """The rows `begin : end` of `image` and `told`."""
    for row in range(begin, end):
        for column in range(wanted.shape[1]):
            if not wanted[row, column] or not sheets.whole[row, column]:
                continue
            down, right = row % 2, column % 2
            if _error(sheets, image, row, column, down, right) > tolerance:
                continue
            if down and right:
                if _error(sheets, image, row, column, 1, -1) > tolerance:
                    continue
                apart = ZERO
                for channel in range(3):
                    one, other = (
                        _cubic(image, row, column, 1, 1, channel),
                        _cubic(image, row, column, 1, -1, channel),
                    )
                    apart = max(apart, HALF * abs(one - other))
                if apart > tolerance:
                    continue
            for channel in range(3):
                colour = _cubic(image, row, column, down, right, channel)
                if down and right:
                    colour = HALF * (colour + _cubic(image, row, column, 1, -1, channel))
                image[row, column, channel] = min(max(colour, ZERO), ONE)
            image[row, column, 3] = ONE
            told[row, column] = True


def _reference(sheets: Sheets, wanted: Array, tolerance: np.float32, image: Array, told: Array) -> None:
    """`_interpolate` in float64, pixel by pixel, the cubic by Lagrange's formula."""
    for row, column in np.argwhere(wanted & sheets.whole):
        here = np.array([row, column])
        lines = np.array([[1, 1], [1, -1]] if row % 2 and column % 2 else [[row % 2, column % 2]])
        places = here + np.array([-3, -1, 1, 3])[:, None] * lines[:, None]
        if (places < 0).any() or (places >= wanted.shape).any():
            continue
        at = places[..., 0], places[..., 1]
        share = abs(sheets.part_weight[at] - sheets.part_weight[row, column]).max()
        turned = (sheets.normal[at].astype(np.float64) @ sheets.normal[row, column]).min()
        same = sheets.whole[at].all() and (sheets.side[at] == sheets.side[row, column]).all()
        point = sheets.position[at].astype(np.float64)
        off = np.linalg.norm(point[:, 1:3].mean(1) - sheets.position[row, column], axis=-1)
        amid = (off <= AMID * np.linalg.norm(point[:, 2] - point[:, 1], axis=-1)).all()
        if not same or share > SAME_SHARE or turned < SAME_SHEET or not amid:
            continue
        colour = image[at][..., :3].astype(np.float64)
        weight = np.array([-1, 9, 9, -1]) / 16
        values = np.einsum("s,lsc->lc", weight, colour)
        error = max(abs(np.diff(colour, 2, axis=1)).max() / 8, np.ptp(values, axis=0).max() / 2)
        if error <= tolerance:
            image[row, column] = [*values.mean(0).clip(0, 1), 1]
            told[row, column] = True
