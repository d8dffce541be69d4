"""The terms of both passes' losses (sec. 5.1 and the appendix's table); their weights are the recipe's (recipe.py).

Letters: r rays, p points. Colours in [0, 1], premultiplied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.training.core.process_group import ALONE, ProcessGroup
from avatarrex.training.core.trained_field import TrainedField
from avatarrex.training.recipe import LossWeights

NEARBY = 0.004
"""Metres: a silhouette that is off by as much costs as much as a missing ray."""
PURE = 0.02
"""Mattes closer to 0 or 1 have no edge in them."""
LOSS_CLAMP = 0.06
"""Metres: farther distances all count the same; the volume's band is as wide."""


@dataclass(frozen=True)
class Mean:
    """A weighted mean before its division: what several processes found can be added up."""

    total: Float[Tensor, ""]
    """Σ w e, differentiable."""
    weight: Float[Tensor, ""]
    """Σ w, without a gradient."""
    least: float = 1e-6
    """Of the divisor."""

    @property
    def value(self) -> Float[Tensor, ""]:
        """Of these alone."""
        return self.over(self.weight)

    def over(self, weight: Float[Tensor, ""]) -> Float[Tensor, ""]:
        """These entries' part of the mean in which all entries weigh `weight`."""
        return self.total / weight.clamp_min(self.least)


def of_share(value: Float[Tensor, ""], share: float) -> Mean:
    """A process's part of a term that several compute whole."""
    return Mean(share * value, value.new_tensor(share))


def of_joined(value: Float[Tensor, ""], share: float) -> Mean:
    """The same of a picture that processes have joined: in each the gradient is that of its own pixels already."""
    return Mean(value - (1 - share) * value.detach(), value.new_tensor(share))


def batch_means(found: dict[int, dict[str, Mean]], units: int, group: ProcessGroup = ALONE) -> dict[str, Tensor]:
    """By name, means over a batch of so many units of the terms that each unit is given with: this process's part of them.

    A unit's mean is over the entries of all processes, its divisor as well.
    """
    names: Sequence[str] = list(next(iter(found.values())))
    weights = torch.zeros(units, len(names))
    for unit, terms in found.items():
        weights[unit] = torch.stack([terms[name].weight.detach().to(weights) for name in names])
    weights = group.sum(weights)
    parts: dict[str, Tensor] = {}
    for unit, terms in found.items():
        for name, weight in zip(names, weights[unit]):
            part = terms[name].over(weight.to(terms[name].total)) / units
            parts[name] = parts.get(name, torch.zeros(())) + part
    return parts


def rgb_loss(colour: Float[Tensor, "r 3"], truth: Float[Tensor, "r 3"], weight: Float[Tensor, " r"]) -> Mean:
    """Mean squared error over rays and channels, rays weighted."""
    return Mean(((colour - truth).square().mean(-1) * weight).sum(), weight.sum())


def mask_loss(opacity: Float[Tensor, " r"], matte: Float[Tensor, " r"], weight: Float[Tensor, " r"]) -> Mean:
    """Mean absolute error, rays weighted."""
    return Mean(((opacity - matte).abs() * weight).sum(), weight.sum())


def silhouette_loss(
    lowest: Float[Tensor, " r"], width: Float[Tensor, " r"], matte: Float[Tensor, " r"], weight: Float[Tensor, " r"]
) -> Mean:
    """How far the silhouette is off, over `NEARBY`: mean over rays of what their lowest distance s lacks, weighted.

    A straight edge at s from a pixel's centre covers 1/2 − s/`width` of it. Where the matte is neither 0 nor 1 that is to
    be met; elsewhere only the wrong side counts (IDR, Yariv et al. 2020, eq. 7: rays that hit the person where the matte
    has it tell nothing). Once γ is small the mask term has no gradient for a ray that misses or enters by a few γ. NaN
    rays (not queried) count nothing. Where hardly any ray has weight (a face with an outline of hair), hardly anything is lost.
    """
    off = (0.5 - matte) * width - lowest
    off = torch.where(matte > 1 - PURE, off.clamp_max(0), torch.where(matte < PURE, off.clamp_min(0), off))
    return Mean((off.abs().nan_to_num(0.0) * weight).sum() / NEARBY, weight.sum(), least=1.0)


def skin_loss(distance: Float[Tensor, " p"]) -> Float[Tensor, ""]:
    """How far a face's surface is off its own mesh, over `NEARBY`: mean |s| at points of that mesh; 0 of none."""
    return distance.abs().sum() / max(len(distance), 1) / NEARBY


def eikonal_loss(field: TrainedField, position: Float[Tensor, "p 3"]) -> Mean:
    """Mean (‖∇s‖ − 1)² of the trained part at points."""
    position = position.detach().requires_grad_(True)
    (slope,) = torch.autograd.grad(field.alone(position).sum(), position, create_graph=True)
    return Mean((slope.norm(dim=-1) - 1).square().sum(), slope.new_tensor(float(len(slope))))


def weighted(terms: dict[str, Tensor], weights: LossWeights) -> Tensor:
    """The weighted sum."""
    return torch.stack([getattr(weights, name) * value for name, value in terms.items()]).sum()


def distance_loss(predicted: Float[Tensor, " p"], target: Float[Tensor, " p"]) -> Tensor:
    """Mean absolute error of clamped distances, near the surface counted more; in units of 5 cm. Of supervised fits."""
    weight = 1 / (1 + target.abs() / 0.01)
    near, wanted = (distance.clamp(-LOSS_CLAMP, LOSS_CLAMP) for distance in (predicted, target))
    return 20 * (weight * (near - wanted).abs()).mean()
