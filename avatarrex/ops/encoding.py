"""Sinusoidal positional encoding γ(x) = (x, sin x, cos x, …, sin 2^{m−1}x, cos 2^{m−1}x) (paper, appendix)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def encode(x: Float[Tensor, "*b c"], octaves: int) -> Float[Tensor, "*b e"]:
    """γ(x) with m = `octaves`; e = c (1 + 2 m). One sine and cosine, then double angles: error below 1e-5 at m = 6."""
    sin, cos = x.sin(), x.cos()
    parts = [x, sin, cos]
    for _ in range(octaves - 1):
        sin, cos = 2 * sin * cos, 1 - 2 * sin * sin
        parts += [sin, cos]
    return torch.cat(parts, -1)


def encode_reference(x: Float[Tensor, "*b c"], octaves: int) -> Float[Tensor, "*b e"]:
    """γ(x) as written."""
    return torch.cat([x, *(wave(2.0**k * x) for k in range(octaves) for wave in (torch.sin, torch.cos))], -1)
