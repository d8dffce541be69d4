"""Several figures in one picture, each rendered alone: composed by depth.

Of the figures that cover a pixel, nearest first, with premultiplied colour c_k and coverage α_k:

    c = Σ_k c_k Π_{l<k} (1 − α_l)      α = 1 − Π_k (1 − α_k)

Edges are taken to cover a pixel independently of each other (Porter and Duff, 'over'). Letters: n figures, h w pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def depth_composite(
    images: Sequence[Float[Tensor, "h w 4"]], depths: Sequence[Float[Tensor, "h w"]]
) -> Float[Tensor, "h w 4"]:
    """At least one premultiplied picture, with camera z of what each shows wherever it covers a pixel in part."""
    image = torch.stack(tuple(images))
    covered = image[..., 3] > 0
    made = image.sum(0)  # right where one figure alone is
    shared = covered.sum(0) > 1
    depth = torch.where(covered, torch.stack(tuple(depths)), torch.inf)[:, shared]
    layers = image[:, shared].take_along_dim(depth.argsort(dim=0, stable=True)[..., None], 0)
    below = layers[-1]
    for layer in layers[:-1].flip(0):
        below = layer + (1 - layer[..., 3:]) * below
    made[shared] = below
    return made
