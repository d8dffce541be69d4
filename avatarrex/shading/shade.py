"""Step III: the colour of every pixel that the avatar covers (paper sec. 4, 'Pixel Shading'; composition eq. 14).

Only covered pixels are evaluated (colour.py). What the colour networks need of a pose (feature patches, colour tri-planes)
is decoded once, when a pixel first asks for it, and kept.

Letters: h w pixels, p covered pixels. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.pointmap.raycast import PointMap
from avatarrex.shading.colour import SurfaceColour
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.build import AvatarVolume
from avatarrex.volume.sdf_volume import PARTS, sides

STILL = 1e-5
"""Metres by which rays may find the same stored surface elsewhere: the grid's origin moved, and numbers are rounded."""


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
    posed: PosedPerson
    volume: AvatarVolume
    view: Camera
    """The camera in the root frame."""


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
    paint = SurfaceColour(avatar, posed, volume.body_frame, volume.views, counters, hands=volume.hands)
    if previous and previous.volume.body_frame is volume.body_frame:
        paint.patches = previous.patches
    if previous and previous.volume.views is volume.views:
        paint.planes = previous.planes
    if detail_from is not None and paint.patches is None:
        paint.patches = _patches_of(avatar, detail_from)
    covered, image = pointmap.coverage > 0, torch.zeros(*pointmap.coverage.shape, 4)
    if previous and volume.follows(previous.volume) and detail_from is None:
        if previous.patches:
            paint.patches = previous.patches.moved(volume.body_frame.code.embedding)
        if previous.view.key() == view.key():
            same = _unchanged(previous, posed, volume, pointmap)
            image[same] = previous.image[same]
            covered = covered & ~same
    position = pointmap.position[covered]
    direction = torch.nn.functional.normalize(position - torch.as_tensor(view.centre, dtype=torch.float32), dim=-1)
    counters.add("pixels_shaded", len(position))
    with torch.no_grad():
        side = sides(volume.sdf, position) if pointmap.side is None else pointmap.side[covered]
        colour = paint.colour(position, direction, pointmap.part_weight[covered], side)
    coverage = pointmap.coverage[covered][:, None]
    image[covered] = torch.cat([colour.clamp(0, 1) * coverage, coverage], -1)
    return Shading(image, pointmap, paint.patches, paint.planes, posed, volume, view)


def _unchanged(previous: Shading, posed: PosedPerson, volume: AvatarVolume, pointmap: PointMap) -> Bool[Tensor, "h w"]:
    """Covered pixels of the same view whose point is where it was and hears nothing that changed."""
    assert volume.changed is not None
    then = previous.pointmap
    same = (pointmap.coverage > 0) & (pointmap.coverage == then.coverage)
    same &= (pointmap.position - then.position).abs().amax(-1) < STILL
    same &= (pointmap.part_weight - then.part_weight).abs().amax(-1) < 1 / 255
    for column, name in enumerate(PARTS):
        if not _same_part(name, posed, previous.posed):
            same &= pointmap.part_weight[..., column] == 0
    same[same.clone()] = torch.from_numpy(~volume.changed.touches(pointmap.position[same].double().numpy()))
    return same


def _same_part(name: str, posed: PosedPerson, then: PosedPerson) -> bool:
    same_place = np.array_equal(posed.root_from_part(name), then.root_from_part(name))
    return posed.parts[name] is then.parts[name] and same_place


def _patches_of(avatar: Avatar, signals: Signals) -> PatchCache:
    """Feature patches of another body pose."""
    with torch.no_grad():
        rotation = matrix_from_rotvec(torch.as_tensor(np.array(signals.body_pose), dtype=torch.float32))
        return PatchCache.of(avatar.body.patch_network, avatar.body.code(rotation).embedding)
