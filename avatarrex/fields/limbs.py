"""The body field split by limb: the nodes near a part along the surface, and all the others (docs/architecture.md).

Letters: n nodes, v vertices, p points. Root frame unless told, metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.influence import Pairs
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.templates.parts import PARTS

OWN_REACH = 0.22
"""Metres at rest around the part's extent: what is nearer is the part's own (forearm; neck, shoulders, chest). More than a
node's influence and the box's margin: a field that lacks some of its nodes is wrong where they are in reach."""
SPLIT_DEVIATION, SPLIT_RIM = 0.5, 0.015
"""Share of the usual deviation allowed to a field of some nodes only, and how far (metres) it reaches past the rim of their skin."""
CLOTH_MARGIN = 0.03
"""Metres around a box in which another limb's vertex counts as in it: its surface may stand off by cloth."""


@dataclass(frozen=True)
class Ownership:
    """Which nodes and vertices belong to a part: those that are near it at rest."""

    own_node: Tensor
    """(n,) bool."""
    other_vertex: np.ndarray
    """(v,) bool."""

    @staticmethod
    def of(rest_node: Tensor, rest_vertices: Tensor, part_vertices: Tensor) -> Ownership:
        """From rest positions (n, 3), (v, 3) and the part's own rest vertices (k, 3), root frame."""
        low, high = part_vertices.amin(0), part_vertices.amax(0)

        def apart(position: Tensor) -> Tensor:
            distance: Tensor = (position - position.clamp(low, high)).norm(dim=-1)
            return distance

        return Ownership(apart(rest_node) < OWN_REACH, (apart(rest_vertices) >= OWN_REACH).numpy())


def nodes_of(ownership: Mapping[str, Ownership], side: int) -> Tensor | None:
    """(n,) the nodes of a side (`Composed.side`); None for the whole body's."""
    if side == WHOLE:
        return None
    own = ownership[PARTS[side // 2]].own_node
    return ~own if side % 2 else own


@dataclass(frozen=True)
class Limbs:
    """The body field of one pose, split: the nodes near a part along the surface, and all others."""

    field: BodyField
    own: tuple[BodyFrame, TemplateDistance]
    """Restricted to the part's own nodes, and their skin."""
    rest: tuple[BodyFrame, TemplateDistance]

    @staticmethod
    def of(field: BodyField, frame: BodyFrame, skin: TemplateDistance, ownership: Ownership) -> Limbs:
        """`skin`: of all limbs."""
        own, other = ownership.own_node, ownership.other_vertex
        sides = ((own, ~other), (~own, other))
        return Limbs(
            field, *((frame.restricted(nodes), skin.of_vertices(vertices, SPLIT_RIM)) for nodes, vertices in sides)
        )

    def own_and_others(self, position: Float[Tensor, "p 3"], pairs: Pairs) -> Float[Tensor, "p 2"]:
        """Both values at points whose `pairs` with all nodes are given, metres."""
        return torch.stack([self._sdf(side, position, pairs) for side in (self.own, self.rest)], -1)

    def others(self, position: Float[Tensor, "p 3"], pairs: Pairs) -> Float[Tensor, " p"]:
        """The second of both."""
        return self._sdf(self.rest, position, pairs)

    @torch.no_grad()
    def _sdf(self, side: tuple[BodyFrame, TemplateDistance], position: Tensor, pairs: Pairs) -> Tensor:
        frame, skin = side
        sdf = self.field.sdf(frame, position, pairs)
        return skin.query(position.double().numpy()).without_hands(sdf, SPLIT_DEVIATION)


def reached_by_others(
    skin: TemplateDistance, ownership: Ownership, part_from_root: np.ndarray, low: np.ndarray, high: np.ndarray
) -> bool:
    """Whether another limb's vertex is within `CLOTH_MARGIN` of the part-frame box from `low` to `high` (3,)."""
    left = np.flatnonzero(ownership.other_vertex)
    for axis in range(3):
        along = skin.vertices[left] @ part_from_root[axis, :3] + part_from_root[axis, 3]
        left = left[(along > low[axis] - CLOTH_MARGIN) & (along < high[axis] + CLOTH_MARGIN)]
    return len(left) > 0
