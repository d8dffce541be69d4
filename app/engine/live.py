"""The surfaces in the window: level `live` of the one pipeline, its picture left in the OpenGL context that is current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from avatarrex_studio.engine.influences import of_surface
from avatarrex_studio.engine.looks import look_of
from avatarrex_studio.engine.request import Seen
from avatarrex_studio.session.state import IMAGE, INFLUENCE, LIVE, StudioState, vector

from avatarrex import levels
from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import StageClock
from avatarrex.live import harmonics_of
from avatarrex.signals.driving import Signals
from avatarrex.stage.lighting import SurfaceLight
from avatarrex.surface.pose import PosedSurface, pose_surface
from avatarrex.surface.raster import SAMPLES, Placed, SurfacePicture, draw_surfaces, surface_geometry
from avatarrex.surface.shadow import Caster, SurfaceShadow


def read_avatar(name: str) -> Avatar:
    """An avatar whose surface was posed once: what is compiled at first use does not make the interface wait. Raises `InputError`."""
    avatar = load_avatar(name)
    if avatar.surface is not None:
        pose_surface(avatar.surface, avatar.person, Signals.rest())
    return avatar


class Tinted(NamedTuple):
    """A figure in the colours of influences."""

    posed: PosedSurface
    selected: str | None
    tinted: PosedSurface
    """The same with the colours as its tints."""


class LiveSurface:
    """Draws the surfaces of a session's figures into one picture, and remembers the one before."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {"surface": 0.0, "raster": 0.0, "total": 0.0}
        """Milliseconds of the last picture by stage; in software the rasteriser goes on after that."""
        self.forget()

    def forget(self) -> None:
        """Let go of the last picture and what it was made of: avatars, their light, textures of a context."""
        self._posed: dict[int, PosedSurface] = {}
        """By figure."""
        self._drawn: tuple[object, ...] = ()
        """What the last picture shows."""
        self._picture: SurfacePicture | None = None
        self._casters: dict[int, Caster] = {}
        self._tinted: dict[int, Tinted] = {}
        """By figure, where influences are shown."""
        self._camera = Camera.orbit()
        self._shine: SurfaceLight | None = None

    @property
    def shadow(self) -> SurfaceShadow | None:
        """The floor's light under the last picture; None without a stage."""
        return self._shine.shadow if self._shine and self._shine.light.floor else None

    def draw(
        self,
        avatars: Sequence[Avatar | None],
        state: StudioState,
        size: tuple[int, int],
        samples: int = SAMPLES,
    ) -> SurfacePicture | None:
        """The picture, (width, height) pixels; `avatars`: of each figure, None for one that is not read yet and left out.

        `samples` of a pixel: 4, 2 or 1. None where nobody is there, or an avatar has no surface.
        """
        there = {k: avatar for k, avatar in enumerate(avatars) if avatar is not None}
        if not there or any(avatar.surface is None for avatar in there.values()):
            return None
        clock, self._camera = StageClock(), state.view.camera(*size)
        with clock("surface"):
            self._casters = self._placed(there, state)
            tinted = self._casters if state.tools.shows == INFLUENCE else {}
            self._tinted = {k: self._coloured(k, there[k], one.posed, state) for k, one in tinted.items()}
            self._casters |= {k: replace(tinted[k], posed=one.tinted) for k, one in self._tinted.items()}
        with clock("raster"):
            places = [self._casters[figure].world_from_root for figure in there]
            lit = [harmonics_of(avatar, place) for avatar, place in zip(there.values(), places)]
            self._picture = self._raster(lit, state, samples)
        self.ms = clock.milliseconds()
        return self._picture

    def point(self, column: int, row: int) -> Seen | None:
        """The surface under the centre of a pixel of the last picture; None where there is none."""
        view, found = self._camera.cropped(column, row, 1, 1), {}
        for figure, one in self._casters.items():
            world = one.world_from_root
            seen = surface_geometry(one.posed, view.seen_from(world), one.hidden)
            if seen.hit[0, 0]:
                point = vector(world[:3, :3] @ seen.position[0, 0] + world[:3, 3])
                found[float(seen.depth[0, 0])] = Seen(point, figure)
        return found[min(found)] if found else None

    def _placed(self, avatars: dict[int, Avatar], state: StudioState) -> dict[int, Caster]:
        """Each figure's surface as its signals place it."""
        made, each = {}, state.each()
        for figure, avatar in avatars.items():
            own, surface = each[figure], avatar.surface
            assert surface is not None
            posed = pose_surface(surface, avatar.person, own.signals, self._posed.get(figure))
            made[figure] = Caster(posed, posed.world_from_root(own.signals), own.hidden | avatar.hidden)
        self._posed = {figure: one.posed for figure, one in made.items()}
        return made

    def _coloured(self, figure: int, avatar: Avatar, posed: PosedSurface, state: StudioState) -> Tinted:
        """A figure in the colours of influences: the same one as long as pose and selection stay, the same colours in another pose."""
        last, selected = self._tinted.get(figure), state.tools.selected
        if last is None or last.posed.surface is not posed.surface or last.selected != selected:
            tint = of_surface(avatar, posed.surface, selected).astype(np.float32)
        elif last.posed is posed:
            return last
        else:
            tint = last.tinted.tint
        return Tinted(posed, selected, replace(posed, tint=tint))

    def _raster(self, harmonics: Sequence[np.ndarray], state: StudioState, samples: int) -> SurfacePicture:
        """All in one picture: the last one, where it shows them as they are."""
        look = look_of(state.tools.shows, state.view)
        light = state.stage.light if look is None and state.tools.shows == IMAGE else None
        casters = list(self._casters.values())
        places = tuple((one.posed, one.world_from_root.tobytes(), one.hidden) for one in casters)
        drawn = (places, self._camera.key(), look, light, tuple(one.tobytes() for one in harmonics), samples)
        if self._picture is not None and drawn == self._drawn:
            return self._picture
        if self._shine is None or self._shine.light != light:
            self._shine = SurfaceLight(light) if light else None
        keys = self._shine.keys(casters) if self._shine else [None] * len(casters)
        placed = [
            Placed(one.posed, lit, self._camera.seen_from(one.world_from_root), one.hidden, look, key)
            for one, lit, key in zip(casters, harmonics, keys)
        ]
        self._drawn = drawn
        return draw_surfaces(placed, samples if levels.level(LIVE).antialias else 1)
