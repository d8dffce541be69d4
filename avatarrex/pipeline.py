"""One frame of the deferred pipeline (paper sec. 4): signals → templates → fields → volume → pointmap → shading.

| stage     | makes                                        | its key: what it depends on                        |
|-----------|----------------------------------------------|----------------------------------------------------|
| templates | posed body, hands (wrist frame), face (head) | each mesh: its own pose coefficients and the shape |
| volume    | body grid + part boxes (Step I)              | posed meshes; placements; voxel sizes; parts seen  |
| pointmap  | where each ray meets the surface (Step II)   | volume, camera in the root frame, polish           |
| shading   | colours of the hit pixels (Step III)         | point map, posed meshes                            |

A stage whose key has not changed returns the previous result and counts no work. With `reuse_tolerance`, volume and shading take over
what hardly moved from the frame before, too (volume/temporal_reuse.py).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pointmap.polish import polish
from avatarrex.pointmap.raycast import PointMap, raycast
from avatarrex.pointmap.visibility import Bounds, hidden_behind
from avatarrex.pointmap.visible_cells import seen_cells
from avatarrex.shading.shade import Shading, shade
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import AvatarVolume, build_volume, part_key, refine_volume
from avatarrex.volume.composed_field import composed_field
from avatarrex.volume.sdf_volume import PARTS, SdfVolume
from avatarrex.volume.template_distance import TemplateDistance


@dataclass(frozen=True)
class RenderSettings:
    """What a user may trade; part of the stages' keys."""

    voxel: float = 0.02
    """Side of a body voxel, metres; it grows where 128 of them would cut the person off."""
    part_voxel: float = 0.0025
    """Side of a voxel of the hand and face boxes, metres."""
    reuse_tolerance: float = 0.0
    """Metres that parts of the body may lag behind the pose: what a frame after another moves by less stays as it was."""
    everywhere: bool = False
    """Evaluate every voxel that the fields reach, not only those around the surface."""
    bricks: int = 0
    """Body voxels that a view meets are cut into this many along each side; 0: none is."""
    raycast: str = "auto"
    """`auto`, `gl`, `torch` or `reference`."""
    march: str = "exact"
    """`exact`, or `fixed`: steps of a quarter of a body voxel and one linear interpolation, without antialiasing."""
    antialias: bool = True
    polish: int = 0
    """Steps, 0 to 2, that take each hit point onto the exact composed field."""
    hidden: frozenset[str] = field(default_factory=frozenset)
    """Parts not drawn with their own fields: `left_hand`, `right_hand`, `face`."""
    detail_from: Signals | None = None
    """Feature patches are decoded from this body pose instead of the one that is drawn (the paper's patch figure)."""


@dataclass(frozen=True)
class Frame:
    """A rendered frame and everything that led to it."""

    image: Float32[Tensor, "h w 4"]
    """Premultiplied sRGB-encoded colour and coverage, row 0 at the top."""
    signals: Signals
    camera: Camera
    settings: RenderSettings
    posed: PosedPerson
    volume: AvatarVolume
    pointmap: PointMap
    shading: Shading
    world_from_root: np.ndarray
    """(4, 4) float64: the point map lives in the root frame."""
    view: Camera
    """`camera` as seen from the root frame."""
    ms: dict[str, float]
    counters: dict[str, int]
    notes: tuple[str, ...]
    """What a person should know: the renderer that cast the rays, fallbacks, extrapolation."""
    device: str = "cpu"
    """Where the networks ran."""


def render_frame(
    avatar: Avatar,
    signals: Signals,
    camera: Camera,
    settings: RenderSettings | None = None,
    previous: Frame | None = None,
) -> Frame:
    """Render `avatar` under the driving `signals` seen by `camera`, reusing what `previous` already holds.

    `previous` must stem from the same avatar. Raises `InputError` for signals or settings that cannot be drawn.
    """
    settings = settings or RenderSettings()
    settings = replace(settings, hidden=settings.hidden | avatar.hidden)
    clock, counters = _Clock(), Counters()
    with clock("templates"):
        posed = pose_person(avatar.person, signals, counters, previous.posed if previous else None)
    world_from_root = posed.world_from_root(signals)
    view = camera.seen_from(world_from_root)
    surface = _Surface(avatar, posed, view, settings, counters, previous)
    with clock("volume"):
        unseen = surface.unseen()
        volume = surface.volume(unseen)
    with clock("pointmap"):
        pointmap = surface.pointmap(volume)
        wrong = surface.shown(unseen, pointmap)
    while wrong:
        unseen -= wrong
        with clock("volume"):
            volume = surface.volume(unseen)
        with clock("pointmap"):
            pointmap = surface.pointmap(volume)
            wrong = surface.shown(unseen, pointmap)
    with clock("shading"):
        kept = previous.shading if previous and previous.settings.detail_from == settings.detail_from else None
        shading = shade(avatar, posed, volume, pointmap, view, counters, kept, settings.detail_from)
    return Frame(
        image=shading.image,
        signals=signals,
        camera=camera,
        settings=settings,
        posed=posed,
        volume=volume,
        pointmap=pointmap,
        shading=shading,
        world_from_root=world_from_root,
        view=view,
        ms=clock.milliseconds(),
        counters=counters.as_dict(),
        notes=(f"rays: {pointmap.renderer}", *volume.notes),
        device=avatar.device,
    )


def _pointmap_key(view: Camera, settings: RenderSettings) -> tuple[object, ...]:
    return (view.key(), settings.raycast, settings.antialias, settings.march, settings.polish)


class _Surface:
    """Steps I and II of one frame: where the view meets the avatar."""

    def __init__(
        self,
        avatar: Avatar,
        posed: PosedPerson,
        view: Camera,
        settings: RenderSettings,
        counters: Counters,
        previous: Frame | None,
    ) -> None:
        self.avatar, self.posed, self.view, self.settings, self.counters = avatar, posed, view, settings, counters
        self.previous = previous
        self.built = self.refined = previous.volume if previous else None
        self.same_view = previous is not None and _pointmap_key(previous.view, previous.settings) == _pointmap_key(
            view, settings
        )
        self.same = self.same_view and previous is not None and previous.posed.keys == posed.keys

    def unseen(self) -> frozenset[str]:
        """Parts that are not built because they are off screen, or seem to be behind the body."""
        settings, kept = self.settings, self.built.keys if self.built else {}
        drawn = (name for name in PARTS if name not in settings.hidden)
        names = frozenset(name for name in drawn if kept.get(name) != part_key(self.posed, settings, name))
        if settings.everywhere or not names:
            return frozenset()
        if self.same and self.previous and self.previous.settings == settings:
            return names  # as before
        missing = {name: self._bounds(name) for name in PARTS if name in names}
        off_screen = frozenset(name for name, part in missing.items() if part.off_screen(self.view))
        asked = {name: part for name, part in missing.items() if name not in off_screen and not self._was_shown(name)}
        if not asked:
            return off_screen
        alone = self._built(names)
        asked = {name: self._bounds(name, alone.skin) for name in asked}
        behind = hidden_behind(asked, SdfVolume(alone.grid), self.view, self.settings.raycast, self.counters)
        return off_screen | behind

    def volume(self, unseen: frozenset[str]) -> AvatarVolume:
        """The volume without the parts `unseen`, with bricks where `view` meets the body, so far as they are not there."""
        volume, previous = self._built(unseen), self.previous
        if not self.settings.bricks or (self.same_view and previous and previous.volume is volume):
            return volume
        cells, coarse = seen_cells(SdfVolume(volume.grid, volume.sdf.parts), self.view, self.settings.raycast)
        self.counters.update(coarse.counters)
        self.refined = refine_volume(self.avatar, volume, cells, self.settings.bricks, self.counters, self.refined)
        return self.refined

    def pointmap(self, volume: AvatarVolume) -> PointMap:
        """What the rays of the view meet."""
        if self.previous and self.same_view and self.previous.volume.sdf is volume.sdf:
            return self.previous.pointmap
        settings = self.settings
        pointmap = raycast(volume.sdf, self.view, settings.raycast, settings.antialias, settings.march)
        self.counters.update(pointmap.counters)
        if settings.polish:
            exact = composed_field(self.avatar, self.posed, volume, self.counters)
            pointmap = polish(pointmap, exact, volume.sdf, self.view, settings.polish, self.counters)
        return pointmap

    def shown(self, unseen: frozenset[str], pointmap: PointMap) -> frozenset[str]:
        """Parts of `unseen` that a ray of the picture may reach after all."""
        if not unseen or (self.same and self.previous and self.previous.pointmap is pointmap):
            return frozenset()
        bounds = {name: self._bounds(name, self.built.skin if self.built else None) for name in unseen}
        reached = (
            n for n, part in bounds.items() if not part.off_screen(self.view) and not part.covered(pointmap, self.view)
        )
        return frozenset(reached)

    def _built(self, unseen: frozenset[str]) -> AvatarVolume:
        self.built = build_volume(self.avatar, self.posed, self.settings, self.counters, self.built, unseen)
        return self.built

    def _bounds(self, name: str, skin: TemplateDistance | None = None) -> Bounds:
        return Bounds.of(self.avatar, self.posed, name, self.settings.part_voxel, skin)

    def _was_shown(self, name: str) -> bool:
        return self.previous is not None and bool(self.previous.pointmap.part_weight[..., PARTS.index(name)].any())


class _Clock:
    """Wall-clock milliseconds per stage."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.stages[stage] = self.stages.get(stage, 0.0) + (time.perf_counter() - start) * 1e3

    def milliseconds(self) -> dict[str, float]:
        return {**self.stages, "total": sum(self.stages.values())}
