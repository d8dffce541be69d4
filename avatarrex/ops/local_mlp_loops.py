"""`local_mlp` in compiled loops on a CPU (ops/native.py): node by node, chunks of rows whose intermediates stay in cache.

Coordinates are encoded (ops/encoding.py) chunk by chunk, too. Products are those of the BLAS that numba finds (scipy's), on chunks so
small that it starts no threads of its own; chunks are spread over ours. A chunk holds rows of one node and does not depend on where
pieces of work are cut.

Letters: k rows sorted by node, n nodes, c input, o output channels, m chunks. Arrays are float32 and int64.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import native

MULTIPLIED = 1 << 18
"""Products of one matrix product up to which OpenBLAS stays with the thread that calls it."""
CHUNK_ROWS = 128
"""Rows of a chunk."""
Array = Shaped[np.ndarray, "..."]
ZERO, HALF, ONE, TWO, LEAST = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2), np.float32(-87)
ROUND = np.float32(1.5 * 2**23)
"""Added, it leaves an integer in the lowest bits."""
LOG2E, LN2, LN2_REST = np.float32(np.log2(np.e)), np.float32(0.693359375), np.float32(np.log(2) - 0.693359375)
P0, P1, P2 = np.float32(1.9875691500e-4), np.float32(1.3981999507e-3), np.float32(8.3334519073e-3)
P3, P4, P5 = np.float32(4.1665795894e-2), np.float32(1.6666665459e-1), np.float32(5.0000001201e-1)
"""(e^r − 1 − r) / r² for |r| ≤ ln 2 / 2, a minimax polynomial (Cephes' `expf`)."""
QUARTERS, QUARTER, QUARTER_REST = np.float32(2 / np.pi), np.float32(1.5703125), np.float32(np.pi / 2 - 1.5703125)
S0, S1, S2 = np.float32(-1.9515295891e-4), np.float32(8.3321608736e-3), np.float32(-1.6666654611e-1)
C0, C1, C2 = np.float32(2.443315711809948e-5), np.float32(-1.388731625493765e-3), np.float32(4.166664568298827e-2)
"""Of sine and cosine up to π/4 (Cephes' `sinf`)."""


def chunks(offsets: Array, widest: int) -> Array:
    """(m, 3) node, first and last row of every chunk, where a product takes at most `widest` weights."""
    rows = min(max(MULTIPLIED // widest, 1), CHUNK_ROWS)
    count = -(-np.diff(offsets) // rows)
    node = np.repeat(np.arange(len(count)), count)
    first = offsets[node] + rows * (np.arange(len(node)) - np.repeat(np.cumsum(count) - count, count))
    return np.stack([node, first, np.minimum(first + rows, offsets[node + 1])], 1)


@native
def forward(
    begin: int,
    end: int,
    chunk: Array,
    coordinate: Array,
    octaves: int,
    limit: np.float32,
    plain: Array,
    weights: tuple[Array, ...],
    stride: Array,
    biases: tuple[Array, ...],
    elu: bool,
    out: Array,
) -> None:
    """out (k, o) of the chunks (m, 3) in `begin : end`.

    Inputs are γ of `coordinate` (0 or 3, k), then the channels of `plain` (k, ·). Biases are (n, o), weights (c, o) of node i
    lie from `i * stride` on.
    """
    encoded = len(coordinate) * (1 + 2 * octaves)
    channels = encoded + plain.shape[1]
    wide = channels
    for bias in biases:
        wide = max(wide, bias.shape[1])
    room = np.empty((2, CHUNK_ROWS * wide), np.float32)
    for piece in range(begin, end):
        node, first, last = chunk[piece]
        rows, side = last - first, 0
        x = room[1, : rows * channels].reshape(channels, rows)
        if encoded:
            encode(coordinate[:, first:last], octaves, limit, x[:encoded])
            for c in range(plain.shape[1]):
                for row in range(rows):
                    x[encoded + c, row] = plain[first + row, c]
        for layer in range(len(weights)):
            bias, of_node, given = biases[layer][node], node * stride[layer], channels
            if layer:
                given = biases[layer - 1].shape[1]
            weight = weights[layer][of_node : of_node + given * len(bias)].reshape(given, len(bias))
            y = room[side, : rows * len(bias)].reshape(rows, len(bias))
            if layer + 1 == len(weights):
                y = out[first:last]
            if layer:
                np.dot(room[1 - side, : rows * given].reshape(rows, given), weight, y)
            elif encoded:
                np.dot(x.T, weight, y)
            else:
                np.dot(plain[first:last], weight, y)
            if layer + 1 == len(weights):
                for row in range(rows):
                    for o in range(len(bias)):
                        y[row, o] += bias[o]
            else:
                _activate(y, bias, elu)
            side = 1 - side


@native
def encode(coordinate: Array, octaves: int, limit: np.float32, out: Array) -> None:
    """γ (c·(1 + 2m), k) of coordinates (c, k): ops/encoding.py."""
    width = len(coordinate)
    for axis in range(width):
        for row in range(coordinate.shape[1]):
            out[axis, row] = min(max(coordinate[axis, row], -limit), limit)
        if octaves:
            _turn(out[axis], out[width + axis], out[2 * width + axis])
        for octave in range(1, octaves):
            at = width * (2 * octave - 1) + axis
            _doubled(out[at], out[at + width], out[at + 2 * width], out[at + 3 * width])


@native
def _doubled(sine: Array, cosine: Array, next_sine: Array, next_cosine: Array) -> None:
    for i in range(len(sine)):
        s, c = sine[i], cosine[i]
        next_sine[i] = s * c * TWO
        next_cosine[i] = (c - s) * (c + s)


@partial(native, fused=True)
def _turn(x: Array, sine: Array, cosine: Array) -> None:
    """Sine and cosine of some turns at most, by Cephes' polynomials on an eighth of a turn."""
    for i in range(len(x)):
        shifted = x[i] * QUARTERS + ROUND
        whole = shifted - ROUND
        r = x[i] - whole * QUARTER - whole * QUARTER_REST
        z = r * r
        s = ((S0 * z + S1) * z + S2) * z * r + r
        c = ((C0 * z + C1) * z + C2) * z * z - HALF * z + ONE
        quarter = np.float32(shifted).view(np.int32)
        along, across = (c, s) if quarter & 1 else (s, c)
        sine[i] = -along if quarter & 2 else along
        cosine[i] = -across if (quarter + 1) & 2 else across


@partial(native, fused=True)
def _activate(h: Array, bias: Array, elu: bool) -> None:
    """ELU or ReLU of h (k, o) + bias, in place; what is not a number stays so."""
    for row in range(len(h)):
        if elu:
            for o in range(len(bias)):
                y = h[row, o] + bias[o]
                x = min(max(y, LEAST), ZERO)
                shifted = x * LOG2E + ROUND
                whole = shifted - ROUND
                r = x - whole * LN2 - whole * LN2_REST
                p = ((((P0 * r + P1) * r + P2) * r + P3) * r + P4) * r + P5
                bits = np.int32((np.float32(shifted).view(np.int32) << np.int32(23)) + np.int32(127 << 23))
                h[row, o] = (p * r * r + r + ONE) * bits.view(np.float32) - ONE if y <= ZERO else y
        else:
            for o in range(len(bias)):
                y = h[row, o] + bias[o]
                h[row, o] = ZERO if y <= ZERO else y
