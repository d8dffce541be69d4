"""No NaN and no Inf crosses a border between two stages: what carries one is refused where it is made."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from avatarrex.errors import InputError


def require_finite(source: str, **tensors: Tensor) -> None:
    """Raise `InputError` naming the first of `tensors` that contains NaN or Inf. One pass: a sum hands both on."""
    for name, value in tensors.items():
        if not math.isfinite(value.detach().sum(dtype=torch.float64)):
            raise InputError(source, name, "finite numbers", "NaN or Inf")
