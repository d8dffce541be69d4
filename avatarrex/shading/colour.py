"""The colour of surface points of one posed avatar: body, hands and face by their shares (paper eq. 14).

The body's points are grouped by node; hands and face are asked where their ω is not zero. Differentiable in the fields'
parameters: training paints with it, too.

Letters: p points. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.hand import HandSurface
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.limbs import nodes_of
from avatarrex.volume.sdf_volume import PARTS

OPAQUE = 0.999
"""Summed ω from which the body's own colour is not computed: its share is below 1/255."""


@dataclass
class SurfaceColour:
    """Colours of one frame; what a pose needs is decoded when it is first asked for."""

    avatar: Avatar
    posed: PosedPerson
    body_frame: BodyFrame
    views: Tensor | None
    """Orthographic views of the face mesh."""
    counters: Counters
    patches: PatchCache | None = None
    """Feature patches of this body pose."""
    planes: Tensor | None = None
    """Colour tri-planes of this expression."""
    hands: dict[str, HandSurface] = field(default_factory=dict)
    """Posed hands, prepared for look-ups; what is missing is added."""
    sparse: bool = False
    """Of few points: the patches of the nodes that they hear alone are decoded, and not kept."""

    def colour(
        self,
        position: Float[Tensor, "p 3"],
        direction: Float[Tensor, "p 3"],
        weight: Float[Tensor, "p 3"],
        side: Int[Tensor, " p"] | None = None,
    ) -> Float[Tensor, "p 3"]:
        """Colours of points seen along unit `direction` (from the eye), with the parts' shares `weight`.

        `side`: whose body each point is on (`Composed.side`), the whole one's unless told.
        """
        colour = torch.zeros_like(position)
        body = torch.nonzero(weight.sum(-1) < OPAQUE)[:, 0]
        if len(body):
            whose = torch.full_like(body, WHOLE) if side is None else side[body]
            for limb in whose.unique().tolist():
                rows = body[whose == limb]
                share = 1 - weight[rows].sum(-1, keepdim=True)
                colour = colour.index_add(0, rows, share * self._body(position[rows], direction[rows], limb))
        for column, name in enumerate(PARTS):
            rows = torch.nonzero(weight[:, column] > 0)[:, 0]
            if len(rows):
                local, gaze = _into(self.posed.root_from_part(name), position[rows], direction[rows])
                part = self._face(local, gaze, direction[rows]) if name == "face" else self._hand(name, local, gaze)
                colour = colour.index_add(0, rows, weight[rows, column, None] * part)
        return colour

    def _body(self, position: Tensor, direction: Tensor, limb: int) -> Tensor:
        body, frame = self.avatar.body, self.body_frame
        among = nodes_of(self.avatar.ownership, limb)
        pairs = body.pairs(frame, position, among)
        patches = None
        if not self.sparse:
            if self.patches is None:
                self.patches = PatchCache.of(body.patch_network, frame.code.embedding)
            self.counters.add("patches_decoded", self.patches.decode(pairs.node))
            patches = self.patches.value
        self.counters.add("body_pixels", len(position))
        self.counters.add("local_mlp_evaluations", len(pairs.point))
        return body.colour(frame, patches, position, direction, pairs, light=self.avatar.light, among=among)

    def _hand(self, name: str, local: Tensor, gaze: Tensor) -> Tensor:
        self.counters.add("hand_pixels", len(local))
        hand, vertices = self.avatar.hand(name), self.posed.parts[name]
        if name not in self.hands:
            self.hands[name] = hand.surface(vertices)
        beside = hand.beside(self.hands[name], local).seen(gaze)
        turned = beside.normal @ torch.as_tensor(self.posed.root_from_part(name)[:3, :3].T).to(local)
        return hand.colour(vertices, self.posed.hand_pose[name], beside) * self.avatar.light(turned)

    def _face(self, local: Tensor, gaze: Tensor, direction: Tensor) -> Tensor:
        if self.planes is None:
            assert self.views is not None, "a pixel of the face, whose views were not drawn"
            self.planes = self.avatar.face.colour_planes(self.views)
            self.counters.add("unet_runs", 3)
        self.counters.add("face_pixels", len(local))
        return self.avatar.tone(self.avatar.face.colour(self.planes, local, gaze), direction, gaze)


def _into(root_from_part: np.ndarray, position: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Root-frame points and directions in a part's frame."""
    part_from_root = torch.as_tensor(np.linalg.inv(root_from_part)).to(position)
    rotation = part_from_root[:3, :3].T
    return position @ rotation + part_from_root[:3, 3], direction @ rotation
