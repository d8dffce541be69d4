"""One frame: of the deferred pipeline (paper sec. 4), or of the avatar's surface (live.py) at level `live`.

signals → templates → fields → volume → pointmap → shading:

| stage     | makes                                        | its key: what it depends on                        |
|-----------|----------------------------------------------|----------------------------------------------------|
| templates | posed body, hands (wrist frame), face (head) | each mesh: its own pose coefficients and the shape |
| volume    | body grid + part boxes (Step I)              | posed meshes; placements; voxel sizes; parts seen  |
| pointmap  | where each ray meets the surface (Step II)   | volume, camera in the root frame, polish           |
| shading   | colours of the hit pixels (Step III)         | point map, posed meshes, light in the root frame   |

A stage whose key has not changed returns the previous result and counts no work. With `reuse_tolerance`, volume and shading
also reuse what has hardly moved since the previous frame (volume/temporal_reuse.py); with `colour_tolerance`, shading interpolates
between the points that earlier views of the pose coloured (shading/known_appearance.py), with `shading_tolerance` between pixels of
the same picture (shading/coarse_shading.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters, StageClock
from avatarrex.frame import DeferredFrame, Frame
from avatarrex.live import render_live
from avatarrex.ops.native import torch_on_one_thread
from avatarrex.pointmap.surface import PointMapKey, VisibleSurface, refine_where_visible, visible_surface
from avatarrex.settings import RenderSettings
from avatarrex.shading.shade import shade
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import AvatarVolume, build_volume
from avatarrex.volume.off_screen import off_screen_parts


def render_frame(
    avatar: Avatar,
    signals: Signals,
    camera: Camera,
    settings: RenderSettings | None = None,
    previous: Frame | None = None,
    between: Callable[[], None] | None = None,
) -> Frame:
    """Render `avatar` under the driving `signals` seen by `camera`.

    `settings` are a level's (`level("fine")`) or your own, `balanced` unless given. With `previous`, a frame of the same
    avatar, a stage is skipped while what it depends on has not changed: `frame.counters` say what was done. The image is
    (h, w, 4), premultiplied sRGB and coverage; depth, normals and positions are in `frame.pointmap` (metres, root frame).
    `between` is called before every stage; what it raises ends the frame and reaches the caller.
    Raises `InputError` for signals or settings that cannot be drawn.
    """
    settings = settings or RenderSettings()
    if settings.surface:
        settings = replace(settings, hidden=settings.hidden | avatar.hidden)
        return render_live(avatar, signals, camera, settings, previous)
    return render_deferred(avatar, signals, camera, settings, previous, between)


@torch_on_one_thread()
def render_deferred(
    avatar: Avatar,
    signals: Signals,
    camera: Camera,
    settings: RenderSettings | None = None,
    previous: Frame | None = None,
    between: Callable[[], None] | None = None,
) -> DeferredFrame:
    """`render_frame` at any level but `live`: the frame has its templates, volume and shading."""
    settings = settings or RenderSettings()
    settings = replace(settings, hidden=settings.hidden | avatar.hidden)
    before = previous if isinstance(previous, DeferredFrame) else None
    clock, counters, old = StageClock(between), Counters(), before.surface if before else None
    with clock("templates"):
        posed = pose_person(avatar.person, signals, counters, old.posed if old else None)
    world_from_root = posed.world_from_root(signals)
    view = camera.seen_from(world_from_root)
    with clock("volume"):
        off_screen = off_screen_parts(avatar, posed, view, settings)
        volume = build_volume(avatar, posed, settings, counters, old.volume if old else None, off_screen)
        volume = refine_where_visible(volume, view, settings, counters, old)
    with clock("pointmap"):
        surface = _reused(old, posed, volume, view, settings) or visible_surface(
            avatar, posed, volume, view, settings, counters, old
        )
    with clock("shading"):
        kept = before.shading if before and before.settings.detail_from == settings.detail_from else None
        shading = shade(avatar, surface, avatar.light.over(world_from_root), counters, kept, settings)
    notes = (f"rays: {surface.pointmap.renderer}",)
    return DeferredFrame(
        signals=signals,
        camera=camera,
        settings=settings,
        world_from_root=world_from_root,
        ms=clock.milliseconds(),
        counters=counters.as_dict(),
        notes=notes,
        device=avatar.device,
        surface=surface,
        shading=shading,
    )


def _reused(
    old: VisibleSurface | None, posed: PosedPerson, volume: AvatarVolume, view: Camera, settings: RenderSettings
) -> VisibleSurface | None:
    """The previous point map, where volume and view are the same."""
    if old is None or old.volume.sdf is not volume.sdf or old.key != PointMapKey.of(view, settings):
        return None
    return replace(old, posed=posed, volume=volume)
