"""Sinusoidal positional encoding (paper appendix, after NeRF).

    γ(x) = (x, sin x, cos x, …, sin 2^{m−1} x, cos 2^{m−1} x)

Letters: p points, c coordinates (3), m octaves; the result has d = c·(1 + 2m) channels, octave by octave, sines first.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


def channels(octaves: int, coordinates: int = 3) -> int:
    """Length of γ(x)."""
    return coordinates * (1 + 2 * octaves)


def encode(x: Float[Tensor, "p c"], octaves: int, limit: float = 2.0) -> Float[Tensor, "p d"]:
    """γ of `x` clamped to ±`limit` per coordinate, by the double-angle recurrence.

    sin 2a = 2 sin a cos a, cos 2a = (cos a − sin a)(cos a + sin a): one sine and one cosine per coordinate. Rounding
    doubles with each octave: 3e-6 at m = 6 (1 − 2 sin² a would leave 1e-5). The clamp keeps a point far outside a ball
    (opposed twists) finite. The result is the transpose of a (d, p) tensor: a channel's values are adjacent, which
    matrix products take as they are.
    """
    rows = x.T.clamp(-limit, limit)
    if torch.is_grad_enabled() and x.requires_grad:
        return torch.cat(_waves(rows, octaves)).T
    width = len(rows)
    out = x.new_empty(channels(octaves, width), len(x))
    out[:width] = rows
    blocks = out[width:].split(width)
    if octaves:
        torch.sin(rows, out=blocks[0])
        torch.cos(rows, out=blocks[1])
    for octave in range(1, octaves):
        sine, cosine = blocks[2 * octave - 2], blocks[2 * octave - 1]
        torch.mul(sine, cosine, out=blocks[2 * octave]).mul_(2)
        torch.sub(cosine, sine, out=blocks[2 * octave + 1]).mul_(cosine + sine)
    return out.T


@dataclass(frozen=True)
class Encoding:
    """`encode` of these points, where it is not needed as a whole: `local_mlp` works it out for the rows in hand."""

    x: Float[Tensor, "p c"]
    octaves: int
    limit: float = 2.0

    def values(self) -> Float[Tensor, "p d"]:
        """γ, (p, d)."""
        return encode(self.x, self.octaves, self.limit)


def encode_reference(x: Float[Tensor, "p c"], octaves: int, limit: float = 2.0) -> Float[Tensor, "p d"]:
    """γ as the equation writes it."""
    x = x.clamp(-limit, limit)
    return torch.cat([x, *(wave(2**octave * x) for octave in range(octaves) for wave in (torch.sin, torch.cos))], -1)


def _waves(rows: Tensor, octaves: int) -> list[Tensor]:
    """The blocks of γ, each (c, p), by operations that autograd follows."""
    blocks, sine, cosine = [rows], torch.sin(rows), torch.cos(rows)
    for octave in range(octaves):
        if octave:
            sine, cosine = 2 * sine * cosine, (cosine - sine) * (cosine + sine)
        blocks += [sine, cosine]
    return blocks
