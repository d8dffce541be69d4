"""Step III: the colour of every pixel that the avatar covers (paper sec. 4, 'Pixel Shading'; composition eq. 14).

Only covered pixels are evaluated (colour.py). What the colour networks need of a pose (feature patches, colour tri-planes)
is decoded once, when a pixel first needs it, and kept.

Letters: h w pixels, p covered pixels. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.pointmap.surface import VisibleSurface
from avatarrex.shading.colour import SurfaceColour
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.signals.driving import Signals
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.sdf_volume import sides

SAME_POSITION = 1e-5
"""Metres by which rays may find the same stored surface elsewhere: the grid's origin moved, and numbers are rounded."""


@dataclass(frozen=True)
class Shading:
    """A shaded image, and what was decoded for it."""

    image: Float32[Tensor, "h w 4"]
    """Premultiplied sRGB-encoded colour and coverage."""
    surface: VisibleSurface
    patches: PatchCache | None
    """Feature patches of this body pose, as far as pixels needed them."""


def shade(
    avatar: Avatar,
    surface: VisibleSurface,
    counters: Counters,
    previous: Shading | None,
    detail_from: Signals | None = None,
) -> Shading:
    """Colour the covered pixels. `detail_from`: see `RenderSettings`; `previous` has the same."""
    volume, pointmap = surface.volume, surface.pointmap
    if previous and previous.surface.pointmap is pointmap and previous.surface.volume is volume:
        return previous
    colours = SurfaceColour(avatar, surface.posed, volume.body_frame, volume.states, counters)
    if previous and previous.surface.volume.body_frame is volume.body_frame:
        colours.patches = previous.patches
    if detail_from is not None and colours.patches is None:
        colours.patches = _patches_of(avatar, detail_from)
    covered, image = pointmap.coverage > 0, torch.zeros(*pointmap.coverage.shape, 4)
    if previous and volume.follows(previous.surface.volume) and detail_from is None:
        if previous.patches:
            colours.patches = previous.patches.moved(volume.body_frame.code.embedding)
        if previous.surface.view.key() == surface.view.key():
            same = _unchanged(previous.surface, surface)
            image[same] = previous.image[same]
            covered = covered & ~same
    position = pointmap.position[covered]
    eye = torch.as_tensor(surface.view.centre, dtype=torch.float32)
    direction = torch.nn.functional.normalize(position - eye, dim=-1)
    counters.add("pixels_shaded", len(position))
    with torch.no_grad():
        side = sides(volume.sdf, position) if pointmap.side is None else pointmap.side[covered]
        colour = colours.colour(position, direction, pointmap.part_weight[covered], side)
    coverage = pointmap.coverage[covered][:, None]
    image[covered] = torch.cat([colour.clamp(0, 1) * coverage, coverage], -1)
    return Shading(image, surface, colours.patches)


def _unchanged(then: VisibleSurface, now: VisibleSurface) -> Bool[Tensor, "h w"]:
    """Covered pixels of the same view whose point is where it was and within reach of nothing that changed."""
    pointmap, old = now.pointmap, then.pointmap
    assert now.volume.changed is not None
    same = (pointmap.coverage > 0) & (pointmap.coverage == old.coverage)
    same &= (pointmap.position - old.position).abs().amax(-1) < SAME_POSITION
    same &= (pointmap.part_weight - old.part_weight).abs().amax(-1) < 1 / 255
    for column, name in enumerate(PARTS):
        if not _same_part(name, now.posed, then.posed):
            same &= pointmap.part_weight[..., column] == 0
    same[same.clone()] = torch.from_numpy(~now.volume.changed.touches(pointmap.position[same].double().numpy()))
    return same


def _same_part(name: str, posed: PosedPerson, then: PosedPerson) -> bool:
    same_place = np.array_equal(posed.root_from_part(name), then.root_from_part(name))
    return posed.parts[name] is then.parts[name] and same_place


def _patches_of(avatar: Avatar, signals: Signals) -> PatchCache:
    """Feature patches of another body pose."""
    with torch.no_grad():
        rotation = matrix_from_rotvec(torch.as_tensor(np.array(signals.body_pose), dtype=torch.float32))
        return PatchCache.of(avatar.body.patch_network, avatar.body.code(rotation).embedding)
