"""The body at a point: its field near the template, without the hands, which are parts of their own.

The template's hands have the pose they were modelled in, whatever a hand does in its own box. Their flesh is removed;
where the template's fingers reach into another limb, that limb's flesh stays. This is the one body of the volume, the
exact field, the references and the training.

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
from avatarrex.fields.limbs import Limbs, Ownership, reached_by_others
from avatarrex.fields.template_distance import NearestSkin, TemplateDistance
from avatarrex.templates.parts import HANDS

REFERENCE_BLOCK = 20000
"""Points that the reference evaluates at once: 128 networks on each."""


@dataclass(frozen=True)
class BodyWithoutHands:
    """The body field of one pose, within `MAX_DEVIATION` of the template distance."""

    field: BodyField
    frame: BodyFrame
    skin: TemplateDistance
    """Of the whole template, with the hands' ω."""
    contact: Mapping[str, Ownership] | None
    """Which nodes are each part's own: limbs that touch the template's hands are split off. None leaves contact out, as
    training and the voxel reference do: there one field of all nodes is enough."""
    reference: bool = False
    """Every node at every point, instead of the pairs in reach."""

    @cached_property
    def touched(self) -> tuple[tuple[np.ndarray, Limbs], ...]:
        """For each hand of the template that another limb reaches: its own vertices (v,), and the split field."""
        found = []
        for name, own in ((name, self.contact[name]) for name in HANDS) if self.contact else ():
            hand = self.skin.vertices[(self.skin.weight > 0) & ~own.other_vertex]
            limbs = self.limbs(name, np.eye(4), hand.min(0), hand.max(0)) if len(hand) else None
            if limbs is not None:
                found.append((~own.other_vertex, limbs))
        return tuple(found)

    @cached_property
    def _split(self) -> dict[str, Limbs]:
        """By part, as far as needed: each has search trees of its own."""
        return {}

    def limbs(self, part: str, part_from_root: np.ndarray, low: np.ndarray, high: np.ndarray) -> Limbs | None:
        """The field split at a part, once for the pose, where another limb reaches the part-frame box from `low` to `high` (3,)."""
        if self.contact is None or not reached_by_others(self.skin, self.contact[part], part_from_root, low, high):
            return None
        if part not in self._split:
            self._split[part] = Limbs.of(self.field, self.frame, self.skin, self.contact[part])
        return self._split[part]

    def sdf(
        self, position: Float[Tensor, "p 3"], counters: Counters, here: NearestSkin | None = None
    ) -> Float[Tensor, " p"]:
        """min((1−ω) s_B + ω max(s_B, 0.02), others) where ω > 0, else s_B. Differentiable in the body's networks.

        `here`: the nearest skin of these points, where it is known.
        """
        here = self.skin.query(position.detach().double().numpy()) if here is None else here
        sdf = here.without_hands(self._field(position, counters))
        for own_vertex, limbs in self.touched if (here.weight > 0).any() else ():
            rows = torch.as_tensor(np.flatnonzero((here.weight > 0) & own_vertex[here.nearest]))
            others = limbs.others(position[rows], self.field.pairs(self.frame, position[rows]))
            sdf = sdf.index_copy(0, rows, sdf[rows].minimum(others))
        return sdf

    def _field(self, position: Tensor, counters: Counters) -> Tensor:
        """s_B of the field alone."""
        if self.reference:
            return torch.cat(
                [self.field.sdf(self.frame, block, impl="reference") for block in position.split(REFERENCE_BLOCK)]
            )
        pairs = self.field.pairs(self.frame, position)
        counters.add("local_mlp_evaluations", len(pairs.point))
        return self.field.sdf(self.frame, position, pairs)
