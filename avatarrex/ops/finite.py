"""No NaN and no Inf crosses a border between two stages: what carries one is refused where it is made."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from avatarrex.errors import InputError


def require_finite(source: str, **tensors: Tensor) -> None:
    """Raise `InputError` naming the first of `tensors` that contains NaN or Inf.

    One pass: a sum hands both on. A sum in single precision takes a fiftieth of one in double; it may overflow, which the
    numbers themselves then decide.
    """
    for name, value in tensors.items():
        total = value.detach().sum(dtype=torch.promote_types(value.dtype, torch.float32))
        if not math.isfinite(total) and not bool(value.detach().isfinite().all()):
            raise InputError(source, name, "finite numbers", "NaN or Inf")
