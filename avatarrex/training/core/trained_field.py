"""The avatar's field at sample points while one part of it is trained, differentiable in that part.

The other parts are read from the frame's stored volume: hands and face while the body is trained, hands and body while
the face is. They are composed by the one rule (fields/composition.py); limbs that touch are not split here.

Letters: p points, k parts. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.composition import Composed, compose
from avatarrex.fields.influence import RADIUS
from avatarrex.ops.trilinear import trilinear
from avatarrex.shading.colour import SurfaceColour
from avatarrex.templates.parts import PARTS
from avatarrex.training.core.frames import TrainingFrame
from avatarrex.volume.sdf_volume import SdfVolume, stored_parts

FACE = PARTS.index("face")


def face_alone(weight: Float[Tensor, "p k"]) -> Float[Tensor, "p k"]:
    """The parts' shares with which the face is painted while it is trained: all of it wherever it has any; others as they are.

    Mixed with a body that knows no colours yet, the face would learn what is missing to the picture instead of the picture.
    """
    alone = torch.zeros_like(weight)
    alone[:, FACE] = 1
    return torch.where(weight[:, FACE, None] > 0, alone, weight)


@runtime_checkable
class TrainedField(Protocol):
    """What pass I needs of a part."""

    def composed(self, position: Float[Tensor, "p 3"]) -> Composed:
        """The avatar's distance and the parts' shares."""
        ...

    def alone(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """The trained part's own distance, for the eikonal term."""
        ...

    def around(self, count: int, noise: torch.Generator) -> Float[Tensor, "p 3"]:
        """Points spread over the space in which the part is defined."""
        ...

    def paint(self) -> SurfaceColour:
        """Colours of the same frame."""
        ...


@dataclass
class TrainedBody:
    """The body under one pose and code."""

    avatar: Avatar
    frame: TrainingFrame
    body_frame: BodyFrame

    def composed(self, position: Float[Tensor, "p 3"]) -> Composed:
        """See `TrainedField`."""
        body = BodyWithoutHands(self.avatar.body, self.body_frame, self.frame.volume.skin, None)
        s_body = body.sdf(position, Counters())
        parts = stored_parts(self.frame.volume.sdf, position)
        own = s_body[:, None].expand_as(parts.sdf)
        return compose(s_body, parts.inside, parts.sdf, parts.omega, own, torch.full_like(parts.sdf, torch.inf))

    def alone(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """See `TrainedField`."""
        return self.avatar.body.sdf(self.body_frame, position)

    def around(self, count: int, noise: torch.Generator) -> Float[Tensor, "p 3"]:
        """Uniform in the nodes' spheres."""
        nodes = self.body_frame.node_position.detach()
        direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=noise), dim=-1)
        radius = RADIUS * torch.rand(count, 1, generator=noise) ** (1 / 3)
        return nodes[torch.randint(len(nodes), (count,), generator=noise)] + radius * direction

    def paint(self) -> SurfaceColour:
        """See `TrainedField`."""
        frame, light = self.frame, self.avatar.light.over(self.frame.world_from_root)
        return SurfaceColour(self.avatar, frame.posed, self.body_frame, frame.states(), light, Counters(), sparse=True)


@dataclass
class TrainedFace:
    """The face under one expression."""

    avatar: Avatar
    frame: TrainingFrame
    planes: Tensor

    def composed(self, position: Float[Tensor, "p 3"]) -> Composed:
        """See `TrainedField`. Without the band of equation 13: a face that leaves it must not hand over to the body."""
        volume = self.frame.volume.sdf
        body = _coarse_body(volume, position)
        omega = stored_parts(volume, position).omega
        rows = torch.nonzero(omega[:, FACE] > 0)[:, 0]
        share = omega[rows, FACE]
        change = share * (self.alone(position[rows]) - body[rows])
        return Composed(body.index_add(0, rows, change), omega)

    def alone(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """See `TrainedField`."""
        head = torch.as_tensor(self.frame.posed.root_from_part("face")).to(position)
        return self.avatar.face.sdf(self.planes, (position - head[:3, 3]) @ head[:3, :3])

    def around(self, count: int, noise: torch.Generator) -> Float[Tensor, "p 3"]:
        """Uniform within 3 cm of the face mesh, more or less."""
        mesh = self.frame.posed.parts["face"][self.avatar.person.face.blend_weight > 0]
        local = mesh[torch.randint(len(mesh), (count,), generator=noise)]
        local = local + 0.03 * (2 * torch.rand(count, 3, generator=noise) - 1)
        head = torch.as_tensor(self.frame.posed.root_from_part("face")).to(local)
        return local @ head[:3, :3].T + head[:3, 3]

    def paint(self) -> SurfaceColour:
        """See `TrainedField`."""
        frame, light = self.frame, self.avatar.light.over(self.frame.world_from_root)
        return SurfaceColour(self.avatar, frame.posed, frame.volume.body_frame, frame.states(), light, Counters())


def _coarse_body(volume: SdfVolume, position: Tensor) -> Tensor:
    """The body grid alone, without bricks (forearms alone have any); beyond the border as at the nearest point of it."""
    grid = volume.body
    place = (position - torch.as_tensor(grid.origin).to(position)) / grid.voxel
    return trilinear(grid.sdf[..., None], place)[:, 0]
