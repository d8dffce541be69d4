"""Step III: the colour of every pixel that the avatar covers (paper sec. 4, 'Pixel Shading'; composition eq. 14).

Only covered pixels are evaluated (colour.py), with `shading_tolerance` a part of them (coarse_shading.py); at occlusion edges two
sheets are mixed (pointmap/occlusion_edges.py). What the colour networks need of a pose (feature patches, colour tri-planes) is decoded
once, when a pixel first needs it, and kept.

Letters: h w pixels, p covered pixels. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.light import Irradiance
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.pointmap.surface import VisibleSurface
from avatarrex.settings import RenderSettings
from avatarrex.shading.coarse_shading import evaluated_first, interpolate
from avatarrex.shading.colour import EarlierViews, SurfaceColour
from avatarrex.shading.known_appearance import KnownAppearance
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.signals.driving import Signals
from avatarrex.templates.parts import PARTS
from avatarrex.volume.sdf_volume import sides

SAME_POSITION = 1e-5
"""Metres by which rays may find the same stored surface elsewhere: the grid's origin moved, and numbers are rounded."""


@dataclass(frozen=True)
class Shading:
    """A shaded image, and what was decoded for it."""

    image: Float32[Tensor, "h w 4"]
    """Premultiplied sRGB-encoded colour and coverage."""
    unmixed: Float32[Tensor, "h w 4"]
    """The same with the colours of the point map's points alone, before the sheets at occlusion edges are mixed."""
    surface: VisibleSurface
    light: Irradiance
    """What fell on it, root frame."""
    patches: PatchCache | None
    """Feature patches of this body pose, as far as pixels needed them."""
    known: KnownAppearance | None
    """What earlier views of this body pose showed, where `colour_tolerance` is not zero."""
    settings: RenderSettings

    def serves(self, settings: RenderSettings) -> bool:
        """Whether its colours are near enough for `settings`."""
        mine = self.settings
        return (
            mine.colour_tolerance <= settings.colour_tolerance and mine.shading_tolerance <= settings.shading_tolerance
        )


def shade(
    avatar: Avatar,
    surface: VisibleSurface,
    light: Irradiance,
    counters: Counters,
    previous: Shading | None,
    settings: RenderSettings,
) -> Shading:
    """Colour the covered pixels in the `light` of the root frame; `previous` has the same `detail_from`."""
    volume, pointmap, tolerance = surface.volume, surface.pointmap, settings.colour_tolerance
    relit = previous is not None and not previous.light.same(light)
    exact = previous is None or (previous.serves(settings) and not relit)
    if previous and exact and previous.surface.pointmap is pointmap and previous.surface.volume is volume:
        return previous
    colours = SurfaceColour(avatar, surface.posed, volume.body_frame, volume.states, light, counters)
    known = None
    if previous and previous.surface.volume.body_frame is volume.body_frame:
        colours.patches = previous.patches
        if tolerance:  # a pose that is seen once teaches nobody
            known = (None if relit else previous.known) or KnownAppearance(avatar.body.appearance_channels + 3)
            colours.earlier = EarlierViews(known, surface.view, tolerance)
    if settings.detail_from is not None and colours.patches is None:
        colours.patches = _patches_of(avatar, settings.detail_from)
    wanted, image = pointmap.coverage > 0, torch.zeros(*pointmap.coverage.shape, 4)
    follows = previous is not None and volume.follows(previous.surface.volume)
    if previous and previous.patches and follows and settings.detail_from is None:
        colours.patches = previous.patches.moved(volume.body_frame.code.embedding)
    if previous and exact and previous.surface.view.key() == surface.view.key():
        same = _unchanged(previous.surface, surface)
        image[same] = previous.unmixed[same]
        wanted = wanted & ~same
    side = pointmap.side
    if settings.shading_tolerance:
        side = _sides(surface) if side is None else side
        first = evaluated_first(wanted)
        _evaluate(image, first, surface, side, colours)
        wanted = wanted & ~first
        wanted = wanted & ~interpolate(image, wanted, pointmap, side, settings.shading_tolerance)
    _evaluate(image, wanted, surface, side, colours)
    return Shading(pointmap.edges.blended(image), image, surface, light, colours.patches, known, settings)


def _evaluate(
    image: Float32[Tensor, "h w 4"],
    wanted: Bool[Tensor, "h w"],
    surface: VisibleSurface,
    side: Int[Tensor, "h w"] | None,
    colours: SurfaceColour,
) -> None:
    """Colour the `wanted` pixels of `image`. `side`: the limb that each is on; None: the volume tells."""
    pointmap, row = surface.pointmap, torch.nonzero(wanted.flatten())[:, 0]
    position, normal, weight = (
        values.flatten(0, 1).index_select(0, row)
        for values in (pointmap.position, pointmap.normal, pointmap.part_weight)
    )
    eye = torch.as_tensor(surface.view.centre, dtype=torch.float32)
    direction = torch.nn.functional.normalize(position - eye, dim=-1)
    colours.counters.add("pixels_shaded", len(position))
    with torch.no_grad():
        limb = sides(surface.volume.sdf, position) if side is None else side.flatten()[row]
        colour = colours.colour(position, direction, weight, limb, normal)
    coverage = pointmap.coverage.view(-1, 1).index_select(0, row)
    image.view(-1, 4).index_copy_(0, row, torch.cat([colour.clamp(0, 1) * coverage, coverage], -1))


def _sides(surface: VisibleSurface) -> Int[Tensor, "h w"] | None:
    """The limb that each covered pixel is on, by the volume; None where no limb touches another."""
    pointmap = surface.pointmap
    row = torch.nonzero(pointmap.coverage.flatten())[:, 0]
    found = sides(surface.volume.sdf, pointmap.position.flatten(0, 1).index_select(0, row))
    if found is None:
        return None
    return (
        torch.full_like(pointmap.coverage, WHOLE, dtype=torch.int64)
        .flatten()
        .index_copy(0, row, found)
        .view_as(pointmap.coverage)
    )


def _unchanged(then: VisibleSurface, now: VisibleSurface) -> Bool[Tensor, "h w"]:
    """Covered pixels of the same view whose point is where it was and within reach of nothing that changed.

    Where the body is the very same, of a hand or a face that moves, their colours are exact; with temporal reuse, as it says.
    """
    pointmap, old, changed = now.pointmap, then.pointmap, now.volume.changed
    unmoved = now.volume.body_frame is then.volume.body_frame and now.volume.sdf.body is then.volume.sdf.body
    if not unmoved and not now.volume.follows(then.volume):
        return torch.zeros_like(pointmap.hit)
    shift, share = (0.0, 0.0) if unmoved else (SAME_POSITION, 1 / 255)
    same = (pointmap.coverage > 0) & (pointmap.coverage == old.coverage)
    if pointmap.side is not None and old.side is not None:
        same &= pointmap.side == old.side
    same &= (pointmap.position - old.position).abs().amax(-1) <= shift
    same &= (pointmap.part_weight - old.part_weight).abs().amax(-1) <= share
    for column, name in enumerate(PARTS):
        if not _same_part(name, now, then):
            same &= pointmap.part_weight[..., column] == 0
            for box in (*now.volume.sdf.parts, *then.volume.sdf.parts):
                if box.name == name and box.contact:  # the limb that a point is on may be another one
                    same[same.clone()] = ~box.holds(pointmap.position[same])
    if changed and not unmoved:
        same[same.clone()] = torch.from_numpy(~changed.touches(pointmap.position[same].double().numpy()))
    return same


def _same_part(name: str, now: VisibleSurface, then: VisibleSurface) -> bool:
    same_place = np.array_equal(now.posed.root_from_part(name), then.posed.root_from_part(name))
    return same_place and now.volume.parts.get(name) is then.volume.parts.get(name)


def _patches_of(avatar: Avatar, signals: Signals) -> PatchCache:
    """Feature patches of another body pose."""
    with torch.no_grad():
        rotation = matrix_from_rotvec(torch.as_tensor(np.array(signals.body_pose), dtype=torch.float32))
        return PatchCache.of(avatar.body.patch_network, avatar.body.code(rotation).embedding)
