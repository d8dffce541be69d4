"""Descent of parameters of which a step sees few: Adam with one second moment for all of them (Nicolet, Jacobson and Jakob 2021).

    m ← β₁ m + (1 − β₁) g,   v ← β₂ v + (1 − β₂) mean g² over those that are seen,   t ← t − η m̂ / √v̂

Adam divides each by its own: a texel that one picture in a hundred shows then moves as far at each look as one that all show, by
about 30 η and wherever that look points, and stands as a speck beside its neighbours. Here it moves as far as its gradients say.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from torch import nn

LEAST = 1e-12
"""Least √v̂."""


class TexelDescent(torch.optim.Optimizer):
    """Of texels (t, 3); `lr` is a common step of one that is seen."""

    def __init__(
        self, parameters: Iterable[nn.Parameter], lr: float, betas: tuple[float, float] = (0.9, 0.999)
    ) -> None:
        super().__init__(parameters, {"lr": lr, "betas": betas})

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """Change what has a gradient."""
        for group in self.param_groups:
            first, second = group["betas"]
            for texel in (one for one in group["params"] if one.grad is not None):
                state, slope = self.state[texel], texel.grad
                if not state:
                    state |= {"step": 0, "mean": torch.zeros_like(texel), "square": texel.new_zeros(())}
                seen = (slope != 0).any(-1)
                if not seen.any():
                    continue
                state["step"] += 1
                state["mean"].lerp_(slope, 1 - first)
                state["square"].lerp_(slope[seen].square().mean(), 1 - second)
                size = (state["square"] / (1 - second ** state["step"])).sqrt().clamp_min(LEAST)
                texel.sub_(group["lr"] / (1 - first ** state["step"]) / size * state["mean"])
