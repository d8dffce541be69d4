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
    made = image.sum(0)  # right where one figure alone is
    shared = (image[..., 3] > 0).sum(0) > 1
    order = torch.stack(tuple(depths))[:, shared].argsort(dim=0, stable=True)
    layers = image[:, shared].take_along_dim(order[..., None], 0)  # what covers nothing hides nothing, wherever it is
    below = layers[-1]
    for layer in layers[:-1].flip(0):
        below = layer + (1 - layer[..., 3:]) * below
    made[shared] = below
    return made
