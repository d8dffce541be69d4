"""The feature patches' convolutions in compiled loops (ops/native.py); what they compute is said in patches.py.

Each layer has its maps in frames of one texel that repeat the border, so that a tap is the same array from another place on, and
every loop runs through a whole map. Two outputs at once: nine numbers are read for eighteen multiplications.

Letters: m patches, n nodes, c input, o output channels, s = `SIDE`. Arrays are float32 and int64.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import borrowing, native

Array = Shaped[np.ndarray, "..."]
SIDE = 32
"""Texels along a patch."""
ROW = SIDE + 2
"""Of a framed map."""
FRAMED = ROW * ROW
ZERO = np.float32(0)
T1, T2, T3, T4, T5, T6, T7, T8, NINE = (np.uintp(k) for k in range(1, 10))
DOWN, TWICE = np.uintp(ROW), np.uintp(2 * ROW)
"""Places of the taps one and two rows down."""


@native
def decode(
    begin: int,
    end: int,
    node: Array,
    encoding: Array,
    kernels: tuple[Array, ...],
    biases: tuple[Array, ...],
    out: Array,
) -> None:
    """out (m, s, s, o) of the nodes (m,) in `begin : end`: convolutions of `encoding` (n, c, s, s), ReLU between them.

    Of kernels (n, o, c or more, 3, 3) the first input channels are used; biases (m, o).
    """
    wide = encoding.shape[1]
    for kernel in kernels:
        wide = max(wide, kernel.shape[1])
    maps, sums = np.empty((wide, FRAMED), np.float32), np.empty((wide + 1, FRAMED), np.float32)
    for patch in range(begin, end):
        i = node[patch]
        given = encoding.shape[1]
        for c in range(given):
            _frame(encoding[i, c].reshape(-1), SIDE, maps[c])
        for layer in range(len(kernels)):
            _convolve(maps.reshape(-1), given, kernels[layer][i], biases[layer][patch], sums.reshape(-1))
            given = len(biases[layer][patch])
            if layer + 1 < len(kernels):
                for o in range(given):
                    for t in range(FRAMED):
                        sums[o, t] = ZERO if sums[o, t] <= ZERO else sums[o, t]
                    _frame(sums[o], ROW, maps[o])
        for y in range(SIDE):
            for x in range(SIDE):
                for o in range(given):
                    out[patch, y, x, o] = sums[o, y * ROW + x]


@borrowing
def _frame(values: Array, row: int, out: Array) -> None:
    """out (ROW²,): values (s rows, `row` apart) within a frame that repeats their border."""
    for y in range(SIDE):
        at = (y + 1) * ROW
        for x in range(SIDE):
            out[at + x + 1] = values[y * row + x]
        out[at], out[at + ROW - 1] = out[at + 1], out[at + SIDE]
    for x in range(ROW):
        out[x], out[FRAMED - ROW + x] = out[ROW + x], out[FRAMED - 2 * ROW + x]


@partial(borrowing, fused=True)
def _convolve(x: Array, channels: int, kernel: Array, bias: Array, y: Array) -> None:
    """y (o · ROW²) of framed maps x (c · ROW²): of each, texel (r, q) at r · `ROW` + q, and nothing beside them that is read.

    Numbers of places are unsigned, for numba would look for negative ones in the innermost loop. The second of a last, single
    output is a repeated one that nobody reads.
    """
    outputs, taps, stride = np.uintp(len(bias)), kernel.reshape(-1), np.uintp(kernel.shape[1]) * NINE
    count = np.uintp(SIDE * ROW - 2)
    for o in range(np.uintp(0), outputs, np.uintp(2)):
        other = min(o + np.uintp(1), outputs - np.uintp(1))
        j, k = o * np.uintp(FRAMED), (o + np.uintp(1)) * np.uintp(FRAMED)
        for t in range(count):
            y[j + t], y[k + t] = bias[o], bias[other]
        for c in range(np.uintp(channels)):
            a, b = o * stride + c * NINE, other * stride + c * NINE
            a0, a1, a2, a3, a4 = taps[a], taps[a + T1], taps[a + T2], taps[a + T3], taps[a + T4]
            a5, a6, a7, a8 = taps[a + T5], taps[a + T6], taps[a + T7], taps[a + T8]
            b0, b1, b2, b3, b4 = taps[b], taps[b + T1], taps[b + T2], taps[b + T3], taps[b + T4]
            b5, b6, b7, b8 = taps[b + T5], taps[b + T6], taps[b + T7], taps[b + T8]
            i = c * np.uintp(FRAMED)
            for t in range(count):
                p = i + t
                x0, x1, x2 = x[p], x[p + T1], x[p + T2]
                x3, x4, x5 = x[p + DOWN], x[p + DOWN + T1], x[p + DOWN + T2]
                x6, x7, x8 = x[p + TWICE], x[p + TWICE + T1], x[p + TWICE + T2]
                first = y[j + t] + a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3 + a4 * x4
                second = y[k + t] + b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3 + b4 * x4
                y[j + t] = first + a5 * x5 + a6 * x6 + a7 * x7 + a8 * x8
                y[k + t] = second + b5 * x5 + b6 * x6 + b7 * x7 + b8 * x8
