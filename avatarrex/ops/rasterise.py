"""Triangles into images by a z-buffer, in compiled loops on a CPU (ops/native.py), float64 until the values.

Pixel centres lie at whole numbers; a pixel shows the nearest triangle that holds its centre, of equally near ones the first. Its
values are those of the corners by barycentrics. Letters: m views, v vertices, f faces, h w pixels, c channels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.native import native, spread

Array = Shaped[np.ndarray, "..."]


class _Buffer(NamedTuple):
    """What every pixel shows so far."""

    depth: Array
    """(m, h, w), −∞ where nothing is."""
    face: Array
    """(m, h, w)"""
    weight: Array
    """(m, h, w, 2) barycentrics of the second and third corner."""


def rasterise(
    pixel: Float[np.ndarray, "m v 2"],
    depth: Float[np.ndarray, "m v"],
    faces: Int[np.ndarray, "f 3"],
    values: Float[np.ndarray, "v c"],
    size: int,
) -> Float[np.ndarray, "m _ h w"]:
    """c channels of `values` and one that is 1 where anything is; 0 elsewhere. `pixel`: column, row; `depth` grows towards the eye."""
    views, shape = len(pixel), (len(pixel), size, size)
    shown = _Buffer(np.full(shape, -np.inf), np.empty(shape, np.int64), np.empty((*shape, 2)))
    spread(_cover, size, pixel, depth, faces, shown, few=1)
    out = np.zeros((views, values.shape[1] + 1, size, size), np.float32)
    spread(_shade, size, faces, values, shown, out, few=1)
    return out


@native
def _cover(begin: int, end: int, pixel: Array, depth: Array, faces: Array, shown: _Buffer) -> None:
    """`shown` of the rows from `begin` to `end` of every view."""
    width = shown.depth.shape[2]
    for m in range(len(pixel)):
        for f in range(len(faces)):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay = pixel[m, i, 0], pixel[m, i, 1]
            bx, by, cx, cy = pixel[m, j, 0] - ax, pixel[m, j, 1] - ay, pixel[m, k, 0] - ax, pixel[m, k, 1] - ay
            low_x, high_x = ax + min(0.0, bx, cx), ax + max(0.0, bx, cx)
            low_y, high_y = ay + min(0.0, by, cy), ay + max(0.0, by, cy)
            area = bx * cy - by * cx
            if area == 0 or not (high_x >= 0 and low_x <= width - 1 and high_y >= begin and low_y <= end - 1):
                continue
            for row in range(max(begin, math.ceil(low_y)), min(end - 1, math.floor(high_y)) + 1):
                for column in range(max(0, math.ceil(low_x)), min(width - 1, math.floor(high_x)) + 1):
                    x, y = column - ax, row - ay
                    v, w = (x * cy - y * cx) / area, (bx * y - by * x) / area
                    u = 1 - v - w
                    if min(u, v, w) >= 0:
                        near = u * depth[m, i] + v * depth[m, j] + w * depth[m, k]
                        if near > shown.depth[m, row, column]:
                            shown.depth[m, row, column], shown.face[m, row, column] = near, f
                            shown.weight[m, row, column, 0], shown.weight[m, row, column, 1] = v, w


@native
def _shade(begin: int, end: int, faces: Array, values: Array, shown: _Buffer, out: Array) -> None:
    """`out` (m, c + 1, h, w) of the rows from `begin` to `end`."""
    views, channels, _, width = out.shape
    for m in range(views):
        for row in range(begin, end):
            for column in range(width):
                if shown.depth[m, row, column] > -np.inf:
                    f = shown.face[m, row, column]
                    v, w = np.float32(shown.weight[m, row, column, 0]), np.float32(shown.weight[m, row, column, 1])
                    u = np.float32(1 - shown.weight[m, row, column, 0] - shown.weight[m, row, column, 1])
                    for c in range(channels - 1):
                        a, b, d = values[faces[f, 0], c], values[faces[f, 1], c], values[faces[f, 2], c]
                        out[m, c, row, column] = a * u + b * v + d * w
                    out[m, channels - 1, row, column] = np.float32(1)
