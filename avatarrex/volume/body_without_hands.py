"""The body without its hands, which are parts of their own: what the volume stores of it, at any point.

The template's hands have the pose they were modelled in, whatever a hand does in its own box. Their flesh is taken away;
where the template's fingers reach into another limb, that limb's flesh stays.

Letters: p points. Root frame, metres, negative inside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.composition import emptied
from avatarrex.volume.limbs import Limbs, Ownership, reached_by_others
from avatarrex.volume.template_distance import NearestSkin, TemplateDistance

HANDS = ("left_hand", "right_hand")


@dataclass(frozen=True)
class BodyWithoutHands:
    """The body field of one pose, held to the template's guess."""

    field: BodyField
    frame: BodyFrame
    skin: TemplateDistance
    """Of the whole skin, with the hands' ω."""
    ownership: Mapping[str, Ownership]

    @cached_property
    def touched(self) -> tuple[tuple[np.ndarray, Limbs], ...]:
        """For each hand of the template into whose place another limb reaches: its own vertices (v,), and all limbs."""
        found = []
        for own in (self.ownership[name] for name in HANDS):
            hand = self.skin.vertices[(self.skin.weight > 0) & ~own.other_vertex]
            if len(hand) and reached_by_others(self.skin, own, np.eye(4), hand.min(0), hand.max(0)):
                found.append((~own.other_vertex, self.limbs(own)))
        return tuple(found)

    def limbs(self, ownership: Ownership) -> Limbs:
        """The field told apart."""
        return Limbs.of(self.field, self.frame, self.skin, ownership)

    @torch.no_grad()
    def sdf(
        self, position: Float[Tensor, "p 3"], counters: Counters, here: NearestSkin | None = None
    ) -> Float[Tensor, " p"]:
        """min((1−ω) s_B + ω max(s_B, 0.02), others) where ω > 0, else s_B; `here`: what the skin says of these points."""
        here = self.skin.query(position.double().numpy()) if here is None else here
        pairs = self.field.pairs(self.frame, position)
        counters.add("local_mlp_evaluations", len(pairs.point))
        sdf = here.clamped(self.field.sdf(self.frame, position, pairs))
        sdf = emptied(sdf, torch.as_tensor(here.weight).to(sdf))
        for own_vertex, limbs in self.touched if (here.weight > 0).any() else ():
            rows = torch.as_tensor(np.flatnonzero((here.weight > 0) & own_vertex[here.nearest]))
            sdf[rows] = sdf[rows].minimum(limbs.others(position[rows], self.field.pairs(self.frame, position[rows])))
        return sdf
