"""The face alone: pictures, mattes and drawings cut by where the template's face is seen.

What a capture of a face shows besides, hair, neck and clothes, is the body field's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

Seen = Callable[[Signals, Camera], Bool[np.ndarray, "h w"]]
"""Pixels in which a camera sees the face of the person under signals."""


def face_alone(person: Person, rig: Rig, drawers: Sequence[Drawer]) -> tuple[Rig, list[Drawer]]:
    """A rig and drawers of `person` that show nothing but the face.

    It is where the centre's ray first meets a triangle of the posed template in which the face's own field has most of the share.
    """
    mesh = PosedMesh(person)
    own = (person.blend_weight[:, PARTS.index("face")].numpy() > 0.5)[mesh.faces].all(1)

    def seen(signals: Signals, camera: Camera) -> Bool[np.ndarray, "h w"]:
        face = mesh.visible(signals, camera)[0]
        inside: np.ndarray = (face >= 0) & own[face]
        return inside

    return FaceRig(**vars(rig), seen=seen), [FaceDrawer(drawer, seen) for drawer in drawers]


@dataclass(frozen=True, eq=False, kw_only=True)
class FaceRig(Rig):
    """A rig, the mattes of which contain the face alone."""

    seen: Seen

    def matte(self, view: int, frame: int) -> UInt8[np.ndarray, "h w"]:
        """See `Rig`."""
        return super().matte(view, frame) * self.seen(self.signals[frame], self.views[view].camera)


class FaceDrawer:
    """A drawer cut by the region."""

    def __init__(self, drawer: Drawer, seen: Seen) -> None:
        self.drawer, self.seen, self.name = drawer, seen, drawer.name

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`."""
        drawing, seen = self.drawer.draw(signals, camera), self.seen(signals, camera)
        return replace(drawing, image=drawing.image * torch.from_numpy(seen)[..., None], hit=drawing.hit & seen)
