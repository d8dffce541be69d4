"""The composed field itself, at any point and without voxels: what the stored volume approximates (sec. 3.4; composition.py).

The builder's definitions point by point: the body without its hands (fields/body_without_hands.py), the parts' own
distances (avatarrex/parts), the one composition rule, and `own`/`others` where another limb is in a part's box
(contact.py). A box is the part's bounds, without a lattice to align to. In the dtype of its fields: float64 for the
oracle (reference/oracle.py), float32 to polish hit points (pointmap/polish.py).

Letters: p points, v vertices, k parts in the order of `PARTS`. Root frame, metres, negative inside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.body import MAX_CLOTHING_OFFSET
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.composition import BAND, Composed, compose, in_band
from avatarrex.fields.limbs import Limbs
from avatarrex.fields.outgrowth import DEVIATION, VOXEL
from avatarrex.fields.template_distance import FLAT, MAX_DEVIATION
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.parts.part import Part, PartState
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.contact import faded, split_share

SURFACE_REACH = FLAT + MAX_CLOTHING_OFFSET + MAX_DEVIATION
"""Metres from the template's nearest vertex within which the clamped body field may be negative (template_distance.py)."""


@dataclass(frozen=True)
class PlacedPart:
    """A posed part in its place, as a field."""

    part: Part[Any]
    state: PartState
    """What the part prepared for this driving signal."""
    part_from_root: Float[np.ndarray, "4 4"]
    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    """The box, part-frame metres."""

    @classmethod
    def of(cls, part: Part[Any], state: PartState, vertices: Tensor, part_from_root: np.ndarray) -> PlacedPart:
        """From the posed mesh (v, 3), part frame."""
        return cls(part, state, part_from_root, *part.bounds(vertices))

    @property
    def name(self) -> str:
        """One of `PARTS`."""
        return self.part.name

    def local(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """Root-frame points in the part's frame."""
        matrix = torch.as_tensor(self.part_from_root).to(position)
        return position @ matrix[:3, :3].T + matrix[:3, 3]

    def apart(self, local: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """Metres from part-frame points to the box; 0 inside."""
        low, high = torch.as_tensor(self.low).to(local), torch.as_tensor(self.high).to(local)
        distance: Tensor = torch.maximum(low - local, local - high).clamp(min=0).norm(dim=-1)
        return distance


@dataclass(frozen=True)
class ComposedField:
    """An avatar's field under one driving signal."""

    body: BodyWithoutHands
    parts: tuple[PlacedPart, ...]
    counters: Counters

    @cached_property
    def limbs(self) -> dict[str, Limbs]:
        """The body field split apart, for the parts into whose boxes another limb reaches."""
        found = {p.name: self.body.limbs(p.name, p.part_from_root, p.low, p.high) for p in self.parts}
        return {name: limbs for name, limbs in found.items() if limbs is not None}

    @torch.no_grad()
    def __call__(self, position: Float[Tensor, "p 3"]) -> Composed:
        """Signed distance and effective ω. Networks run only where their value has a share."""
        count = len(position), len(PARTS)
        inside = torch.zeros(count, dtype=torch.bool)
        sdf, omega, split = position.new_zeros(count), position.new_zeros(count), position.new_zeros(count)
        for part in self.parts:
            k = PARTS.index(part.name)
            local = part.local(position)
            inside[:, k] = part.apart(local) == 0
            if part.name in self.limbs:
                split[:, k] = split_share(local, part.low, part.high)
            rows = torch.nonzero(inside[:, k])[:, 0]
            if len(rows):
                sdf[rows, k], omega[rows, k] = part.part.distance(part.state, local[rows])
                self.counters.add(part.part.work, len(rows))
        idle = in_band(sdf) & (omega == 1)  # the body has no share in such a part
        touched = [PARTS.index(name) for name in self.limbs]
        idle[:, touched] = split[:, touched] == 1  # nor the whole body where limbs are split apart
        body = self._body(position, inside.any(-1) & (idle | ~inside).all(-1))
        own, others = body[:, None].repeat(1, len(PARTS)), torch.full_like(sdf, torch.inf)
        for name, limbs in self.limbs.items():
            k = PARTS.index(name)
            rows = torch.nonzero(inside[:, k])[:, 0]
            pairs = self.body.field.pairs(self.body.frame, position[rows])
            apart = faded(limbs.own_and_others(position[rows], pairs), body[rows], split[rows, k])
            own[rows, k], others[rows, k] = apart.unbind(-1)
            self.counters.add("local_mlp_evaluations", len(pairs.point))
        sdf = torch.where(in_band(sdf), sdf, BAND[1])  # an infinite distance times ω = 0 would be NaN
        return compose(body, inside, sdf, omega, own, others)

    def sdf(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """The signed distance alone."""
        return self(position).sdf

    def clearance(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """A distance within which the field is certainly positive; 0 where it may be negative.

        By what `clamped` and the boxes guarantee, whatever the networks say: no sample is spent there and nothing missed.
        Nothing is known of a hand's place where another limb reaches into it.
        """
        here = self.body.skin.query(position.double().numpy())
        free = (here.guess > here.deviation) & ~((here.weight > 0) & bool(self.body.touched))
        clear = torch.as_tensor(np.where(free, np.maximum(here.distance - self._reach, 1e-9), 0.0)).to(position)
        for part in self.parts:
            clear = clear.minimum(part.apart(part.local(position)))
        return clear

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(3,) corners of a root-frame box that holds the surface."""
        vertices = [self.body.skin.vertices]
        for part in self.parts:
            corners = np.stack(np.meshgrid(*zip(part.low, part.high)), -1).reshape(-1, 3)
            vertices.append((corners - part.part_from_root[:3, 3]) @ part.part_from_root[:3, :3])
        points = np.concatenate(vertices)
        return points.min(0) - self._reach, points.max(0) + self._reach

    @cached_property
    def _reach(self) -> float:
        outgrowth = self.body.skin.outgrowth
        if outgrowth is None:
            return SURFACE_REACH
        apart: np.ndarray = closest_vertex(self.body.skin.closest, outgrowth.points)[0]
        return max(SURFACE_REACH, float(apart.max()) + VOXEL + DEVIATION)

    def _body(self, position: Tensor, idle: Bool[Tensor, " p"]) -> Tensor:
        """s_B (p,), 0 where `idle`."""
        sdf = torch.zeros_like(position[:, 0])
        rows = torch.nonzero(~idle)[:, 0]
        if len(rows):
            sdf[rows] = self.body.sdf(position[rows], self.counters)
        return sdf


def composed_field(
    avatar: Avatar, posed: PosedPerson, body: BodyWithoutHands, states: Mapping[str, PartState], counters: Counters
) -> ComposedField:
    """The field of a body and of those parts whose states are there, in the dtype that they have."""
    parts = (
        PlacedPart.of(avatar.parts[name], state, posed.parts[name], np.linalg.inv(posed.root_from_part(name)))
        for name, state in states.items()
    )
    return ComposedField(body, tuple(parts), counters)
