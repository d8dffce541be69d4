"""`local_mlp` in compiled loops on a CPU (ops/native.py): node by node, chunks of rows whose intermediates stay in cache.

Channels lie first: a chunk's values of one channel are adjacent, and every loop runs over rows. Coordinates are encoded
(ops/encoding.py) chunk by chunk, too. A product takes eight channels and two outputs at once: ten numbers are read and two written
for sixteen multiplications, and the weights of all sixteen stay in registers. So products run at two to three times the rate of
OpenBLAS on matrices of this size, and no threads but ours are started. A chunk holds rows of one node and does not depend on
where pieces of work are cut.

Letters: k rows sorted by node, n nodes, c input, o output channels, m chunks. Arrays are float32 and int64.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import borrowing, native

ROWS = 128
"""Rows of a chunk: with 64 channels before and after a layer 64 KiB."""
WIDTH = 16
"""Rows are computed in whole vectors of this many; what the rest of the last one holds is not read."""
CHANNELS, OUTPUTS = 8, 2
"""Of one pass of a product: widths are multiples of these, padded with zeros (`padded`)."""
Array = Shaped[np.ndarray, "..."]
NEXT, STEP, STEP2, STEP3, STEP4, STEP5, STEP6, STEP7 = (np.uintp(k) for k in (1, *range(ROWS, 8 * ROWS, ROWS)))
"""From one output's weight to the next, and from one channel's values to those of later ones."""
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


def chunks(offsets: Array) -> Array:
    """(m, 3) node, first and last row of every chunk."""
    count = -(-np.diff(offsets) // ROWS)
    node = np.repeat(np.arange(len(count)), count)
    first = offsets[node] + ROWS * (np.arange(len(node)) - np.repeat(np.cumsum(count) - count, count))
    return np.stack([node, first, np.minimum(first + ROWS, offsets[node + 1])], 1)


def padded(values: Array, *multiples: int) -> Array:
    """`values` with zeros after them along the last axes, up to multiples of these; what needs none is not copied.

    A zero times an infinite number is none: where widths are padded, a row with infinite values ends as NaN.
    """
    kept = values.ndim - len(multiples)
    shape = values.shape[:kept] + tuple(size + -size % each for size, each in zip(values.shape[kept:], multiples))
    if shape == values.shape:
        return np.ascontiguousarray(values)
    out = np.zeros(shape, values.dtype)  # numpy's own `pad` takes ten times as long for few numbers
    out[tuple(map(slice, values.shape))] = values
    return out


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
    biases: tuple[Array, ...],
    elu: bool,
    out: Array,
) -> None:
    """out (k, o) of the chunks (m, 3) in `begin : end`.

    Inputs are γ of `coordinate` (0 or 3, k), then the channels of `plain` (k, ·). Weights are (n, c, o) and biases (n, o), padded:
    c to what is above (`CHANNELS` for the inputs), o to `CHANNELS`, of the last layer to `OUTPUTS`.
    """
    encoded = len(coordinate) * (1 + 2 * octaves)
    wide = weights[0].shape[1]
    for weight in weights:
        wide = max(wide, weight.shape[2])
    room = np.zeros((2, wide, ROWS), np.float32)
    for piece in range(begin, end):
        node, first, last = chunk[piece]
        rows, side = last - first, 0
        whole = (rows + WIDTH - 1) // WIDTH * WIDTH
        if encoded:
            encode(coordinate, first, last, octaves, limit, room[0])
        for c in range(plain.shape[1]):
            for row in range(rows):
                room[0, encoded + c, row] = plain[first + row, c]
        room[0, encoded + plain.shape[1] : weights[0].shape[1]] = ZERO
        for layer in range(len(weights)):
            _multiply(
                room[side].reshape(-1), weights[layer][node], biases[layer][node], whole, room[1 - side].reshape(-1)
            )
            side = 1 - side
            if layer + 1 < len(weights):
                _activate(room[side].reshape(-1), weights[layer].shape[2], whole, elu)
        for row in range(rows):
            for o in range(out.shape[1]):
                out[first + row, o] = room[side, o, row]


@partial(borrowing, fused=True)
def _multiply(x: Array, weight: Array, bias: Array, rows: int, y: Array) -> None:
    """y = Wx + b of one node: channels of x and y (c · `ROWS`), weight (c, o), both multiples of `CHANNELS` and `OUTPUTS`.

    Numbers of places are unsigned, for numba would look for negative ones in the innermost loop.
    """
    channels, outputs, count = np.uintp(weight.shape[0]), np.uintp(weight.shape[1]), np.uintp(rows)
    w = weight.reshape(-1)
    for o in range(outputs):
        for row in range(count):
            y[o * STEP + row] = bias[o]
    for c in range(np.uintp(0), channels, np.uintp(CHANNELS)):
        for o in range(np.uintp(0), outputs, np.uintp(OUTPUTS)):
            k, i, j = c * outputs + o, c * STEP, o * STEP
            a0, b0, k = w[k], w[k + NEXT], k + outputs
            a1, b1, k = w[k], w[k + NEXT], k + outputs
            a2, b2, k = w[k], w[k + NEXT], k + outputs
            a3, b3, k = w[k], w[k + NEXT], k + outputs
            a4, b4, k = w[k], w[k + NEXT], k + outputs
            a5, b5, k = w[k], w[k + NEXT], k + outputs
            a6, b6, k = w[k], w[k + NEXT], k + outputs
            a7, b7 = w[k], w[k + NEXT]
            for row in range(count):
                x0, x1, x2, x3 = x[i + row], x[i + STEP + row], x[i + STEP2 + row], x[i + STEP3 + row]
                x4, x5, x6, x7 = x[i + STEP4 + row], x[i + STEP5 + row], x[i + STEP6 + row], x[i + STEP7 + row]
                a = y[j + row] + a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3 + a4 * x4 + a5 * x5 + a6 * x6 + a7 * x7
                b = y[j + STEP + row] + b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3 + b4 * x4 + b5 * x5 + b6 * x6 + b7 * x7
                y[j + row], y[j + STEP + row] = a, b


@borrowing
def encode(coordinate: Array, first: int, last: int, octaves: int, limit: np.float32, out: Array) -> None:
    """γ of the coordinates (c, k) of rows `first : last` into the first columns of out (c·(1 + 2m) or more, `ROWS`):
    ops/encoding.py.
    """
    width, rows = len(coordinate), last - first
    for axis in range(width):
        x, clamped = coordinate[axis, first:last], out[axis, :rows]
        for row in range(rows):
            low = -limit if x[row] < -limit else x[row]  # selected: `min` and `max` jump
            clamped[row] = limit if low > limit else low
        if octaves:
            _turn(out[axis, :rows], out[width + axis, :rows], out[2 * width + axis, :rows])
        for octave in range(1, octaves):
            at = width * (2 * octave - 1) + axis
            sine, cosine = out[at, :rows], out[at + width, :rows]
            _doubled(sine, cosine, out[at + 2 * width, :rows], out[at + 3 * width, :rows])


@borrowing
def _doubled(sine: Array, cosine: Array, next_sine: Array, next_cosine: Array) -> None:
    for i in range(len(sine)):
        s, c = sine[i], cosine[i]
        next_sine[i] = s * c * TWO
        next_cosine[i] = (c - s) * (c + s)


@partial(borrowing, fused=True)
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
        along, across = c if quarter & 1 else s, s if quarter & 1 else c
        sine[i] = -along if quarter & 2 else along
        cosine[i] = -across if (quarter + 1) & 2 else across


@partial(borrowing, fused=True)
def _activate(h: Array, outputs: int, rows: int, elu: bool) -> None:
    """ELU or ReLU of h (o · `ROWS`), in place; what is not a number stays so."""
    for o in range(np.uintp(outputs)):
        for i in range(o * STEP, o * STEP + np.uintp(rows)):
            y = h[i]
            if elu:
                x = min(max(y, LEAST), ZERO)
                shifted = x * LOG2E + ROUND
                whole = shifted - ROUND
                r = x - whole * LN2 - whole * LN2_REST
                p = ((((P0 * r + P1) * r + P2) * r + P3) * r + P4) * r + P5
                bits = np.int32((np.float32(shifted).view(np.int32) << np.int32(23)) + np.int32(127 << 23))
                h[i] = (p * r * r + r + ONE) * bits.view(np.float32) - ONE if y <= ZERO else y
            else:
                h[i] = ZERO if y <= ZERO else y
