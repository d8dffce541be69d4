"""Sinusoidal positional encoding (paper appendix, after NeRF).

    γ(x) = (x, sin x, cos x, …, sin 2^{m−1} x, cos 2^{m−1} x)

Letters: c coordinates (3), m octaves; the result has c·(1 + 2m) channels, octave by octave, sines before cosines.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def channels(octaves: int, coordinates: int = 3) -> int:
    """Length of γ(x)."""
    return coordinates * (1 + 2 * octaves)


def encode(x: Float[Tensor, "*b c"], octaves: int, limit: float = 2.0) -> Float[Tensor, "*b d"]:
    """γ of `x` clamped to ±`limit` per coordinate, by the double-angle recurrence.

    sin 2a = 2 sin a cos a, cos 2a = 1 − 2 sin² a: one sine and one cosine per coordinate. Rounding doubles with each
    octave: 1e-6 at m = 6. The clamp keeps a point far outside a node's ball (opposed twists) finite.
    """
    x = x.clamp(-limit, limit)
    sine, cosine = torch.sin(x), torch.cos(x)
    if torch.is_grad_enabled() and x.requires_grad:
        parts = [x]
        for octave in range(octaves):
            parts += [sine, cosine]
            if octave + 1 < octaves:
                sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
        return torch.cat(parts, -1)
    width = x.shape[-1]
    out = x.new_empty(*x.shape[:-1], channels(octaves, width))
    out[..., :width] = x
    for octave in range(octaves):
        start = width * (1 + 2 * octave)
        out[..., start : start + width] = sine
        out[..., start + width : start + 2 * width] = cosine
        if octave + 1 < octaves:
            sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
    return out


def encode_reference(x: Float[Tensor, "*b c"], octaves: int, limit: float = 2.0) -> Float[Tensor, "*b d"]:
    """γ as the equation writes it."""
    x = x.clamp(-limit, limit)
    return torch.cat([x, *(wave(2**octave * x) for octave in range(octaves) for wave in (torch.sin, torch.cos))], -1)
