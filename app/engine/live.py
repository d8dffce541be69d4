"""The surface in the window: level `live` of the one pipeline, its picture left in the OpenGL context that is current."""

from __future__ import annotations

from dataclasses import replace

from avatarrex_studio.engine.looks import look_of
from avatarrex_studio.session.state import IMAGE, LIVE, StudioState, Vector, vector

from avatarrex import levels
from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.live import LiveFrame, render_live
from avatarrex.signals.driving import Signals
from avatarrex.stage.lighting import SurfaceLight
from avatarrex.surface.pose import pose_surface
from avatarrex.surface.raster import SurfacePicture, surface_geometry
from avatarrex.surface.shadow import SurfaceShadow


def read_avatar(name: str) -> Avatar:
    """An avatar whose surface was posed once: what is compiled at first use does not make the interface wait. Raises `InputError`."""
    avatar = load_avatar(name)
    if avatar.surface is not None:
        pose_surface(avatar.surface, avatar.person, Signals.rest())
    return avatar


class LiveSurface:
    """Draws the surface of the avatar that is open, and remembers the frame before."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {"surface": 0.0, "raster": 0.0, "total": 0.0}
        """Milliseconds of the last picture by stage; in software the rasteriser goes on after that."""
        self.forget()

    def forget(self) -> None:
        """Let go of the last picture and what it was made of: the avatar, its light, textures of a context."""
        self._avatar: Avatar | None = None
        self._previous: LiveFrame | None = None
        self._shine: SurfaceLight | None = None

    @property
    def shadow(self) -> SurfaceShadow | None:
        """The floor's light under the last picture; None without a stage."""
        return self._shine.shadow if self._shine and self._shine.light.floor else None

    def draw(self, avatar: Avatar, state: StudioState, size: tuple[int, int]) -> SurfacePicture | None:
        """The picture, (width, height) pixels; None for an avatar without a surface."""
        if avatar.surface is None:
            return None
        if avatar is not self._avatar:
            self._avatar, self._previous = avatar, None
        settings = replace(levels.level(LIVE), hidden=state.hidden | avatar.hidden)
        look = look_of(state.tools.shows, state.view)
        light = state.stage.light if look is None and state.tools.shows == IMAGE else None
        if self._shine is None or self._shine.light != light:
            self._shine = SurfaceLight(light) if light else None
        camera = state.view.camera(*size)
        frame = render_live(avatar, state.signals, camera, settings, self._previous, look or self._shine)
        self._previous, self.ms = frame, frame.ms
        return frame.picture

    def point(self, column: int, row: int) -> Vector | None:
        """World metres: the surface under the centre of a pixel of the last picture; None where there is none."""
        frame = self._previous
        if frame is None:
            return None
        found = surface_geometry(frame.posed, frame.view.cropped(column, row, 1, 1), frame.settings.hidden)
        if not found.hit[0, 0]:
            return None
        world = frame.world_from_root
        return vector(world[:3, :3] @ found.position[0, 0] + world[:3, 3])
