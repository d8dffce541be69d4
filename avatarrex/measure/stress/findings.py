"""What the checks of a case found: a figure for each, compared with its tolerance; and a digest of every number seen.

The digest tells whether the same case gave the same bits again. A figure that is not a number fails any tolerance.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Finding:
    """One check of one case."""

    check: str
    figure: float
    tolerance: float
    note: str = ""

    @property
    def excess(self) -> float:
        """By how much the figure exceeds the tolerance."""
        return self.figure - self.tolerance

    @property
    def failed(self) -> bool:
        """Whether the figure exceeds the tolerance or is no number."""
        return not self.figure <= self.tolerance


class Findings:
    """Collects the findings of one case."""

    def __init__(self) -> None:
        self.found: list[Finding] = []
        self._digest = hashlib.blake2b(digest_size=16)

    @property
    def digest(self) -> str:
        """Of all tensors that `finite` has seen."""
        return self._digest.hexdigest()

    def at_most(self, check: str, figure: Tensor | np.ndarray | float, tolerance: float, note: str = "") -> None:
        """The largest of `figure` (0 where it is empty) is at most `tolerance`."""
        values = torch.as_tensor(figure)
        worst = float(values.max()) if values.numel() else 0.0
        # torch's max hands NaN on
        self.found.append(Finding(check, math.inf if math.isnan(worst) else worst, tolerance, note))

    def finite(self, check: str, *tensors: Tensor | np.ndarray) -> None:
        """No NaN and no Inf; the figure counts them."""
        bad = 0
        for tensor in tensors:
            value = torch.as_tensor(tensor).detach().contiguous()
            self._digest.update(value.numpy().tobytes())
            bad += int((~torch.isfinite(value)).sum())
        self.at_most(check, float(bad), 0)

    def within(self, check: str, values: Tensor, low: float, high: float, tolerance: float = 0.0) -> None:
        """`low` ≤ values ≤ `high`; the figure is how far the worst lies outside."""
        self.at_most(check, torch.maximum(low - values, values - high).clamp_min(0), tolerance)

    def unit(self, check: str, vectors: Tensor, tolerance: float) -> None:
        """Vectors (…, 3) of length one; the figure is the worst difference."""
        self.at_most(check, (vectors.double().norm(dim=-1) - 1).abs(), tolerance)

    def flag(self, check: str, ok: bool, note: str = "") -> None:
        """A yes or no: 0 where `ok`, else 1, tolerance 0."""
        self.at_most(check, float(not ok), 0, note)
