"""Step II: the surface that a view sees of a posed avatar (paper sec. 4); rays against the volume, polished where wished.

Letters: h w image. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pointmap.kept_hits import KeptHits
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.polish import polish
from avatarrex.pointmap.raycast import raycast, sees_what_it_meets
from avatarrex.pointmap.visible_cells import visible_cells
from avatarrex.settings import RenderSettings
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.build import AvatarVolume, refine_volume
from avatarrex.volume.composed_field import composed_field
from avatarrex.volume.sdf_volume import SdfVolume


@dataclass(frozen=True)
class PointMapKey:
    """What a point map depends on, besides its volume."""

    view: tuple[int, int, bytes, bytes]
    """`Camera.key`."""
    raycast: str
    antialias: bool
    march: str
    polish: int

    @classmethod
    def of(cls, view: Camera, settings: RenderSettings) -> PointMapKey:
        """Of a root-frame camera."""
        return cls(view.key(), settings.raycast, settings.antialias, settings.march, settings.polish)


@dataclass(frozen=True)
class VisibleSurface:
    """What a view sees of a posed avatar."""

    posed: PosedPerson
    volume: AvatarVolume
    view: Camera
    """The camera in the root frame."""
    pointmap: PointMap
    key: PointMapKey


def refine_where_visible(
    volume: AvatarVolume,
    view: Camera,
    settings: RenderSettings,
    counters: Counters,
    previous: VisibleSurface | None,
) -> AvatarVolume:
    """`volume` with bricks where `view` meets the body; those that are there are reused."""
    same_view = previous is not None and previous.key == PointMapKey.of(view, settings)
    if not settings.bricks or (same_view and previous and previous.volume is volume):
        return volume
    cells, coarse = visible_cells(SdfVolume(volume.grid, volume.sdf.parts), view, settings.raycast)
    counters.update(coarse.counters)
    return refine_volume(volume, cells, settings.bricks, counters, previous.volume if previous else None)


def visible_surface(
    avatar: Avatar,
    posed: PosedPerson,
    volume: AvatarVolume,
    view: Camera,
    settings: RenderSettings,
    counters: Counters,
    previous: VisibleSurface | None = None,
) -> VisibleSurface:
    """What the rays of `view` meet; those keep their hits from `previous` that meet nothing which changed (kept_hits.py)."""
    key = PointMapKey.of(view, settings)
    kept = None
    if previous and previous.key == key and settings.march == "exact" and sees_what_it_meets(settings.raycast):
        kept = KeptHits.of(previous.pointmap, previous.volume.sdf, volume.sdf, view)
    if kept and not kept.anew.any():
        return VisibleSurface(posed, volume, view, replace(kept.pointmap, counters={}), key)
    only = kept.anew if kept else None
    pointmap = raycast(volume.sdf, view, settings.raycast, settings.antialias, settings.march, only)
    counters.update(pointmap.counters)
    if only is not None:
        pointmap = replace(pointmap, coverage=pointmap.coverage * only)
    if settings.polish:
        exact = composed_field(avatar, posed, volume.body, volume.states, counters)
        pointmap = polish(pointmap, exact, volume.sdf, view, settings.polish, counters)
    return VisibleSurface(posed, volume, view, kept.joined(pointmap) if kept else pointmap, key)
