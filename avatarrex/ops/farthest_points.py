"""Farthest point sampling in a compiled loop: every point is the one farthest from those before it.

Float64, coordinates summed in their order. Letters: v points, d coordinates, n chosen ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from avatarrex.ops.native import native

Array = Shaped[np.ndarray, "..."]


def farthest_points(points: Float[Tensor, "v d"], count: int, seed: int) -> Int[Tensor, " n"]:
    """Indices of `count` points, or of all if there are fewer, each the farthest from those before it; the first one is drawn by
    `seed`."""
    chosen = torch.empty(min(count, len(points)), dtype=torch.long)
    chosen[:1] = torch.randint(len(points), (1,), generator=torch.Generator().manual_seed(seed))
    _choose(points.detach().cpu().double().T.contiguous().numpy(), chosen.numpy())
    return chosen


@native
def _choose(column: Array, chosen: Array) -> Any:
    """Fill `chosen` (n,) after its first; `column` (d, v). A loop for each coordinate: such loops take several points at once."""
    nearest, square = np.full(column.shape[1], np.inf), np.empty(column.shape[1])
    for n in range(1, len(chosen)):
        square[:] = 0
        for c in range(len(column)):
            place = column[c, chosen[n - 1]]
            for v in range(len(square)):
                square[v] += (column[c, v] - place) ** 2
        farthest, most = 0, -1.0
        for v in range(len(square)):
            least = square[v] if square[v] < nearest[v] else nearest[v]
            nearest[v] = least
            if least > most:
                farthest, most = v, least
        chosen[n] = farthest
