"""Step III: the colour of every pixel that the avatar covers (paper sec. 4, 'Pixel Shading'; composition eq. 14).

Only covered pixels are evaluated (paint.py). What the colour networks need of a pose (feature patches, colour tri-planes)
is decoded once, when a pixel first asks for it, and kept.

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
from avatarrex.fields.hand import HandSurface
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.pointmap.pointmap import PointMap
from avatarrex.shading.paint import Paint
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.signals.signals import Signals
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.build import AvatarVolume


@dataclass(frozen=True)
class Shading:
    """A shaded image, and what was decoded for it."""

    image: Float32[Tensor, "h w 4"]
    """Premultiplied sRGB-encoded colour and coverage."""
    pointmap: PointMap
    patches: PatchCache | None
    """Feature patches of this body pose, as far as pixels asked for them."""
    planes: Tensor | None
    """Colour tri-planes of this expression, once decoded."""
    hands: dict[str, HandSurface]
    """Posed hands prepared for look-ups, of those that were seen."""
    posed: PosedPerson
    volume: AvatarVolume


def shade(
    avatar: Avatar,
    posed: PosedPerson,
    volume: AvatarVolume,
    pointmap: PointMap,
    view: Camera,
    counters: Counters,
    previous: Shading | None,
    detail_from: Signals | None = None,
) -> Shading:
    """Colour the covered pixels; `view` is the camera in the root frame. `detail_from`: see `RenderSettings`."""
    if previous and previous.pointmap is pointmap and previous.volume is volume:
        return previous
    paint = Paint(avatar, posed, volume.body_frame, volume.views, counters)
    if previous and previous.volume.body_frame is volume.body_frame:
        paint.patches = previous.patches
    if previous and previous.volume.views is volume.views:
        paint.planes = previous.planes
    if previous:
        paint.hands = {k: hand for k, hand in previous.hands.items() if previous.posed.parts[k] is posed.parts[k]}
    if detail_from is not None and paint.patches is None:
        paint.patches = _patches_of(avatar, detail_from)
    covered = pointmap.coverage > 0
    position = pointmap.position[covered]
    direction = torch.nn.functional.normalize(position - torch.as_tensor(view.centre, dtype=torch.float32), dim=-1)
    counters.add("pixels_shaded", len(position))
    with torch.no_grad():
        colour = paint.colour(position, direction, pointmap.part_weight[covered])
    image = torch.zeros(*covered.shape, 4)
    coverage = pointmap.coverage[covered][:, None]
    image[covered] = torch.cat([colour.clamp(0, 1) * coverage, coverage], -1)
    return Shading(image, pointmap, paint.patches, paint.planes, paint.hands, posed, volume)


def _patches_of(avatar: Avatar, signals: Signals) -> PatchCache:
    """Feature patches of another body pose."""
    with torch.no_grad():
        rotation = matrix_from_rotvec(torch.as_tensor(np.array(signals.body_pose), dtype=torch.float32))
        return PatchCache.of(avatar.body.patch_network, avatar.body.code(rotation).embedding)
