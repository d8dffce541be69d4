"""The exact field and its colours under one driving signal, as the target of the surface (sec. 3.4; volume/composed_field.py)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.shading.colour import SurfaceColour
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import body_frame, template_distance
from avatarrex.volume.composed_field import ComposedField, composed_field


@dataclass(frozen=True)
class ExactPose:
    """An avatar under one driving signal, without voxels. Root frame, metres."""

    posed: PosedPerson
    field: ComposedField
    colours: SurfaceColour

    @classmethod
    def of(cls, avatar: Avatar, signals: Signals) -> ExactPose:
        """Poses the templates and prepares the parts that the avatar draws."""
        counters = Counters()
        posed = pose_person(avatar.person, signals, counters, None)
        frame, skin = body_frame(avatar, posed), template_distance(avatar, posed)
        body = BodyWithoutHands(avatar.body, frame, skin, avatar.ownership)
        states = {
            name: part.prepare(posed.parts[name], posed.coefficients[name], counters)
            for name, part in avatar.parts.items()
            if name not in avatar.hidden
        }
        light = avatar.light.over(posed.world_from_root(signals))
        colours = SurfaceColour(avatar, posed, frame, states, light, counters)
        return cls(posed, composed_field(avatar, posed, body, states, counters), colours)

    @torch.no_grad()
    def colour(self, position: Float[Tensor, "p 3"], direction: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """sRGB of surface points seen along unit `direction` (from the eye)."""
        found = self.field(position)
        return self.colours.colour(position, normalize(direction, dim=-1), found.part_weight, found.side).clamp(0, 1)
