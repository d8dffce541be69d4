"""A light from pictures alone: how colours of the same texel differ as it is turned. Ours.

    min over h and albedos a of  Σ ω |c − a_t E_h(n)|² + λ |h|²

of pixels with colour c on texels t (`fields/light.py`: E, h). Steps like Gauss and Newton's in h, with a_t = Σ ω c / Σ ω E and slopes of
the channels' mean E; a light that reaches `DARKEST` is not found exactly. Pixels that are far off, shadows and what slid, count less
(Geman–McClure). What no turn tells stays in the albedo: λ is that of a texel whose harmonics vary by `LEAST_TURN`.

Letters: p pixels, k texels around one, t texels. sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.fields.light import Irradiance, basis

ROUNDS, STRAY = 3, 0.1
"""Steps, and the difference in sRGB at which a pixel's weight has fallen to a quarter."""
LEAST_TURN = 0.03
"""Standard deviation of a harmonic over a texel's pixels that is believed as much as no light."""


@dataclass(frozen=True)
class LitPixels:
    """Pixels of one picture on texels, and how they are turned."""

    texel: Int[Tensor, "p k"]
    weight: Float[Tensor, "p k"]
    colour: Float[Tensor, "p 3"]
    normal: Float[Tensor, "p 3"]
    """Unit, in the frame in which the light is fixed."""


@torch.no_grad()
def fit_light(harmonics: Float[Tensor, "8 3"], pictures: Sequence[LitPixels], texels: int) -> Float[Tensor, "8 3"]:
    """The light that explains `pictures` of so many texels best, from `harmonics` on."""
    found, albedo = harmonics.detach().clone(), None
    for _ in range(ROUNDS):
        albedo, change = _albedos(found, pictures, texels, albedo)
        square, right = 1e-6 * torch.eye(8).repeat(3, 1, 1), torch.zeros(3, 8)
        for one in pictures:
            off, weight = _residual(found, one, albedo)
            lit = Irradiance(found)(one.normal).mean(-1)
            slope = basis(one.normal)[:, None] - lit[:, None, None] * change[one.texel]
            for channel in range(3):
                texel = albedo[one.texel, channel]
                row = (texel[..., None] * slope).flatten(0, 1)
                counted, least = weight.flatten(), LEAST_TURN**2 * (weight * texel.square()).sum()
                square[channel] += row.T @ (counted[:, None] * row) + least * torch.eye(8)
                right[channel] += row.T @ (counted * off[..., channel].flatten()) - least * found[:, channel]
        found = found + torch.linalg.solve(square, right).T
    return found


def _residual(
    harmonics: Tensor, one: LitPixels, albedo: Float[Tensor, "t 3"]
) -> tuple[Float[Tensor, "p k 3"], Float[Tensor, "p k"]]:
    """What colours are off, and what each counts."""
    off = one.colour[:, None] - albedo[one.texel] * Irradiance(harmonics)(one.normal)[:, None]
    return off, one.weight / (1 + off.square().mean(-1) / STRAY**2).square()


def _albedos(
    harmonics: Tensor, pictures: Sequence[LitPixels], texels: int, before: Tensor | None
) -> tuple[Float[Tensor, "t 3"], Float[Tensor, "t 8"]]:
    """The albedo of each texel in this light, by weights of those `before`, and how its logarithm falls with the harmonics."""
    sums = torch.zeros(texels, 15)
    for one in pictures:
        weight = one.weight if before is None else _residual(harmonics, one, before)[1]
        lit = Irradiance(harmonics)(one.normal)
        values = torch.cat([torch.ones_like(lit[:, :1]), one.colour, lit, basis(one.normal)], -1)
        sums.index_add_(0, one.texel.flatten(), (weight[..., None] * values[:, None]).flatten(0, 1))
    albedo = sums[:, 1:4] / sums[:, 4:7].clamp_min(1e-9)
    return albedo, sums[:, 7:] / sums[:, 4:7].mean(-1, keepdim=True).clamp_min(1e-9)
