"""The face alone: pictures, mattes and drawings cut by where the template's face is seen.

What a capture of a face shows besides, hair, neck and clothes, is the body field's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, UInt8

from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig
from avatarrex.metrics.baselines import PosedMesh
from avatarrex.metrics.drawing import Drawer, Drawing
from avatarrex.signals.driving import Signals
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import Person

FACE = PARTS.index("face")


def face_alone(person: Person, rig: Rig, drawers: Sequence[Drawer]) -> tuple[Rig, list[Drawer]]:
    """A rig and drawers of `person` that show nothing but the face."""
    region = FaceRegion(person)
    return FaceRig.of(rig, region), [FaceDrawer(drawer, region) for drawer in drawers]


class FaceRegion:
    """Where a camera sees the face of the posed template: its own field has most of the say there."""

    def __init__(self, person: Person) -> None:
        self.mesh = PosedMesh(person)
        own = person.blend_weight[:, FACE].numpy() > 0.5
        self.own = own[person.body.faces.numpy()].all(1)

    def seen(self, signals: Signals, camera: Camera) -> Bool[np.ndarray, "h w"]:
        """Pixels whose centre's ray meets the face first."""
        face = self.mesh.visible(signals, camera)[0]
        return (face >= 0) & self.own[face]


@dataclass(frozen=True, eq=False)
class FaceRig(Rig):
    """A rig whose mattes keep the face alone."""

    region: FaceRegion | None = None

    @classmethod
    def of(cls, rig: Rig, region: FaceRegion) -> FaceRig:
        """The same pictures."""
        return cls(**vars(rig), region=region)

    def matte(self, view: int, frame: int) -> UInt8[np.ndarray, "h w"]:
        """See `Rig`."""
        assert self.region is not None
        return super().matte(view, frame) * self.region.seen(self.signals[frame], self.views[view].camera)


class FaceDrawer:
    """A drawer cut by the region."""

    def __init__(self, drawer: Drawer, region: FaceRegion) -> None:
        self.drawer, self.region, self.name = drawer, region, drawer.name

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`."""
        drawing, seen = self.drawer.draw(signals, camera), self.region.seen(signals, camera)
        return replace(drawing, image=drawing.image * torch.from_numpy(seen)[..., None], hit=drawing.hit & seen)
