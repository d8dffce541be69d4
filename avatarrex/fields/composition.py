"""How body, hands and face become one field (paper sec. 3.4, both equations) and one colour, without carving flesh.

Letters: p points; k parts whose boxes may contain a point, in any order; s_k a part's signed distance, ω_k its painted
blend weight; `own` and `others` the body field of the nodes near part k along the surface and of all remaining nodes
(`others` = +∞ where no other limb is near). Metres. `shaders/lib/composition.glsl` mirrors this file name by name.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

BAND = (-0.05, 0.025)
"""Open interval of s_k, metres, in which a part is blended (eq. 13)."""
WHOLE = -1
"""Side of a point where limbs are not split."""
EMPTIED = 0.02
"""Metres: what the body field holds at least where a part has taken over (ω = 1)."""


@dataclass(frozen=True)
class Composed:
    """The avatar's field at points."""

    sdf: Float[Tensor, " p"]
    part_weight: Float[Tensor, "p k"]
    """Effective ω: the share of each part's colour; the body has the rest."""
    side: Int[Tensor, " p"] | None = None
    """The limb whose surface is nearest: `WHOLE`, or where limbs are split, 2k for the limb of part k and 2k + 1 for all others."""


def blend_literal(
    omega: Float[Tensor, " p"], part_sdf: Float[Tensor, " p"], part: Float[Tensor, "p *c"], body: Float[Tensor, "p *c"]
) -> Float[Tensor, "p *c"]:
    """Equations 13 and 14 as printed: ω part + (1−ω) body inside the band, else the body; values or colours."""
    weight = torch.where(in_band(part_sdf), omega, 0.0).reshape(-1, *(1 for _ in part.shape[1:]))
    return torch.where(weight == 0, body, weight * part + (1 - weight) * body)


def in_band(part_sdf: Float[Tensor, "*p"]) -> Bool[Tensor, "*p"]:
    """−0.05 < s_k < 0.025."""
    return (part_sdf > BAND[0]) & (part_sdf < BAND[1])


def emptied(body: Float[Tensor, " p"], hand_weight: Float[Tensor, " p"]) -> Float[Tensor, " p"]:
    """The body field without its hands: s_B ← (1−ω) s_B + ω max(s_B, 0.02)."""
    return (1 - hand_weight) * body + hand_weight * body.clamp_min(EMPTIED)


def compose(
    body: Float[Tensor, " p"],
    inside: Bool[Tensor, "p k"],
    part_sdf: Float[Tensor, "p k"],
    omega: Float[Tensor, "p k"],
    own: Float[Tensor, "p k"],
    others: Float[Tensor, "p k"],
) -> Composed:
    """The union rule: s = min(min_k c_k, max_k others_k) over the boxes that contain the point, s = s_B in none.

    c_k = ω_k s_k + (1−ω_k) own inside the band, else own. The result does not depend on the order of the parts.
    A point whose nearest sheet is `others` takes no part's colour; parts that tie share it.
    """
    blended = in_band(part_sdf)
    c = torch.where(blended, omega * part_sdf + (1 - omega) * own, own).masked_fill(~inside, torch.inf)
    nearest_own, part = c.min(-1)
    nearest_other, touched = others.masked_fill(~inside, -torch.inf).max(-1)
    any_part = inside.any(-1)
    sdf = torch.where(any_part, torch.minimum(nearest_own, nearest_other), body)
    wins = inside & (c == sdf[:, None])
    share = torch.where(wins & blended, omega, 0.0) / wins.sum(-1, keepdim=True).clamp_min(1)
    side = torch.where(nearest_own < nearest_other, 2 * part, 2 * touched + 1)
    split = nearest_other.isfinite() & (nearest_own != nearest_other)
    return Composed(sdf, share, torch.where(split, side, WHOLE))


def step_bound(
    sdf: Float[Tensor, " p"],
    inside: Bool[Tensor, "p k"],
    part_sdf: Float[Tensor, "p k"],
    own: Float[Tensor, "p k"],
    others: Float[Tensor, "p k"],
) -> Float[Tensor, " p"]:
    """How far a ray may step where the composed field is `sdf`; ≥ 0.

    Inside boxes min(|s|, |own|, |s_k|, |others|): where the band ends the blend jumps, and the surface may then be as
    near as either of its terms; where the terms have opposite signs it may be nearer than both. In no box |s|.
    """
    term = torch.minimum(torch.minimum(own.abs(), part_sdf.abs()), others.abs())
    return torch.minimum(sdf.abs(), term.masked_fill(~inside, torch.inf).amin(-1))


def compose_colour(
    part_weight: Float[Tensor, "p k"], part: Float[Tensor, "p k 3"], body: Float[Tensor, "p 3"]
) -> Float[Tensor, "p 3"]:
    """Σ_k ω_k c_k + (1 − Σ_k ω_k) c_B with the effective weights of `compose`; sRGB."""
    return (part_weight[..., None] * part).sum(1) + (1 - part_weight.sum(-1, keepdim=True)) * body
