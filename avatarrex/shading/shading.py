"""Step III: the colour of every pixel that the avatar covers (paper sec. 4, 'Pixel Shading'; composition eq. 14).

Only covered pixels are evaluated, the body's grouped by node, hands and face where their ω is not zero. What the colour
networks need of a pose (feature patches, colour tri-planes) is decoded once, when a pixel first asks for it.

Letters: h w pixels, p covered pixels. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pointmap.pointmap import PointMap
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.build import AvatarVolume

PARTS = ("left_hand", "right_hand", "face")
"""Order of `PointMap.part_weight`."""
OPAQUE = 0.999
"""Summed ω from which the body's own colour is not computed: its share is below 1/255."""


@dataclass(frozen=True)
class Shading:
    """A shaded image, and what was decoded for it."""

    image: Float32[Tensor, "h w 4"]
    """Premultiplied sRGB-encoded colour and coverage."""
    pointmap: PointMap
    patches: Tensor | None
    """Feature patches (n, c, 32, 32) of this body pose, once decoded."""
    planes: Tensor | None
    """Colour tri-planes of this expression, once decoded."""
    volume: AvatarVolume


def shade(
    avatar: Avatar,
    posed: PosedPerson,
    volume: AvatarVolume,
    pointmap: PointMap,
    view: Camera,
    counters: Counters,
    previous: Shading | None,
) -> Shading:
    """Colour the covered pixels; `view` is the camera in the root frame."""
    if previous and previous.pointmap is pointmap and previous.volume is volume:
        return previous
    patches = previous.patches if previous and previous.volume.body_frame is volume.body_frame else None
    planes = previous.planes if previous and previous.volume.views is volume.views else None
    covered = pointmap.coverage > 0
    position = pointmap.position[covered]
    weight = pointmap.part_weight[covered]
    direction = torch.nn.functional.normalize(position - torch.as_tensor(view.centre, dtype=torch.float32), dim=-1)
    colour = torch.zeros_like(position)
    counters.add("pixels_shaded", len(position))
    body = torch.nonzero(weight.sum(-1) < OPAQUE)[:, 0]
    with torch.no_grad():
        if len(body):
            if patches is None:
                patches = avatar.body.patches(volume.body_frame)
                counters.add("patches_decoded", len(patches))
            pairs = avatar.body.pairs(volume.body_frame, position[body])
            counters.add("body_pixels", len(body))
            counters.add("local_mlp_evaluations", len(pairs.point))
            share = 1 - weight[body].sum(-1, keepdim=True)
            colour[body] = share * avatar.body.colour(
                volume.body_frame, patches, position[body], direction[body], pairs
            )
        for column, name in enumerate(PARTS):
            rows = torch.nonzero(weight[:, column] > 0)[:, 0]
            if not len(rows):
                continue
            root_from_part = posed.root_from_part(name)
            local, gaze = _into(root_from_part, position[rows], direction[rows])
            if name == "face":
                assert volume.views is not None
                if planes is None:
                    planes = avatar.face.colour_planes(volume.views)
                    counters.add("unet_runs", 3)
                part_colour = avatar.face.colour(planes, local, gaze)
                counters.add("face_pixels", len(rows))
            else:
                part_colour = avatar.hand(name).colour(posed.parts[name], posed.hand_pose[name], local)
                counters.add("hand_pixels", len(rows))
            colour[rows] += weight[rows, column, None] * part_colour
    image = torch.zeros(*covered.shape, 4)
    coverage = pointmap.coverage[covered][:, None]
    image[covered] = torch.cat([colour.clamp(0, 1) * coverage, coverage], -1)
    return Shading(image, pointmap, patches, planes, volume)


def _into(root_from_part: np.ndarray, position: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Root-frame points and directions in a part's frame."""
    part_from_root = torch.as_tensor(np.linalg.inv(root_from_part), dtype=torch.float32)
    rotation = part_from_root[:3, :3].T
    return position @ rotation + part_from_root[:3, 3], direction @ rotation
