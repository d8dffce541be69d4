"""What one training picture shows of the surface: pixels with their places, before they are put on texels.

Letters: p pixels. Root frame, metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.fields.light import Irradiance
from avatarrex.fields.local_frame import Neighbours, Samples
from avatarrex.parts.part import PartState
from avatarrex.templates.posed import PosedPerson


@dataclass(frozen=True)
class Sighting:
    """Pixels of one picture on the surface."""

    posed: PosedPerson
    world_from_root: Float[np.ndarray, "4 4"]
    samples: Samples
    """Of the body in this pose."""
    states: Mapping[str, PartState]
    """Of the parts."""
    position: Float[Tensor, "p 3"]
    colour: Float[Tensor, "p 3"]
    weight: Float[Tensor, " p"]
    """The squared cosine at which they are seen."""
    parallax: Float[Tensor, "p 3"]
    """How far the same rays meet a surface that stands a metre higher: to the eye, 1 over the cosine long."""

    def raised(self, height: Float[Tensor, " p"]) -> Sighting:
        """On a surface that stands so much higher."""
        return replace(self, position=self.position + height[:, None] * self.parallax)

    @property
    def gaze(self) -> Float[Tensor, "p 3"]:
        """Unit directions from the eye."""
        return -torch.nn.functional.normalize(self.parallax, dim=-1)

    @cached_property
    def beside(self) -> Neighbours:
        """The samples of the body that carry them."""
        return self.samples.neighbours_of(self.position)

    def light(self, avatar: Avatar) -> Irradiance:
        """What fell on them, as the avatar has it by now."""
        return avatar.light.over(self.world_from_root)

    def slid(self, avatar: Avatar) -> Samples:
        """The samples as the body slides by now."""
        return avatar.body.slid(self.samples, self.posed.body.skinning)
