"""Ramps of the painted blend weights ω: how much each part's own field makes the surface (paper eq. 13).

Letters: v vertices.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def smooth_ramp(value: Float[Tensor, "*v"], low: float, high: float) -> Float[Tensor, "*v"]:
    """3t² − 2t³ of t = (value − low)/(high − low): exactly 0 up to `low`, exactly 1 from `high`."""
    t = ((value - low) / (high - low)).clamp(0, 1)
    return t * t * (3 - 2 * t)
