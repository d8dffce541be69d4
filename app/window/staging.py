"""The picture on its stage, drawn in the window: exact picture over surface over floor over background (`shaders/window/stage.frag`)."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import moderngl
import numpy as np
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.window.canvas import Canvas, release
from avatarrex_studio.window.layers import Layers

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.files.images import read_pixels
from avatarrex.gl.shader import draw_program
from avatarrex.stage.composite import POOL, POOL_RADIUS
from avatarrex.stage.stage import BACKDROPS, GRADIENT, PICTURE
from avatarrex.surface.floor import FADE, KEY, SKY, FloorLight
from avatarrex.surface.shadow import SurfaceShadow

log = logging.getLogger(__name__)
CONSTANTS = {"FADE": FADE, "KEY": KEY, "SKY": SKY, "POOL_RADIUS": POOL_RADIUS}
SURFACE, EXACT, PICTURE_UNIT, SURFACE_FLOOR, EXACT_FLOOR = range(5)
UNITS = {
    "u_surface": SURFACE, "u_exact": EXACT, "u_picture": PICTURE_UNIT, "u_surface_floor": SURFACE_FLOOR,
    "u_exact_floor": EXACT_FLOOR,
}  # fmt: skip
"""Texture units by name."""


@dataclass(frozen=True)
class Scene:
    """What a picture stands in."""

    state: StudioState
    camera: Camera
    """Of the picture's raster."""
    surface_floor: SurfaceShadow | None
    exact_floor: FloorLight | None


class Staging:
    """Draws layers into their scene."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context, self._canvas = context, Canvas(context)
        self._program = draw_program(context, "window/whole.vert", "window/stage.frag", CONSTANTS)
        self._triangle = context.vertex_array(self._program, [])
        self._nothing = context.texture((1, 1), 4, bytes(4))
        self._floor: tuple[FloorLight, moderngl.Texture] | None = None
        self._picture: tuple[str, moderngl.Texture | None] = ("", None)

    def draw(self, layers: Layers, scene: Scene) -> moderngl.Texture:
        """Straight-alpha sRGB bytes, (width, height); the same texture as long as the size stays."""
        program, size = self._program, layers.size
        floor = self._uploaded(scene.exact_floor) if scene.exact_floor else None
        picture = self._read(scene.state.stage.picture) if scene.state.stage.backdrop == PICTURE else None
        shadow = scene.surface_floor
        textures = layers.surface, layers.exact, picture, shadow.texture if shadow else None, floor
        for (name, unit), bound in zip(UNITS.items(), textures):
            (bound or self._nothing).use(unit)
            program[name] = unit
        program["u_weight"] = layers.weight
        program["u_floor_weight"] = layers.weight if shadow and floor else float(floor is not None)
        program["u_surface_region"] = shadow.region if shadow else (0.0, 0.0, 0.0, 0.0)
        program["u_exact_region"] = scene.exact_floor.region if scene.exact_floor else (0.0, 0.0, 0.0, 0.0)
        self._behind(scene.state, size, picture)
        self._on_floor(scene, size)
        with self._canvas.drawing(size) as texture:
            self._triangle.render(moderngl.TRIANGLES, vertices=3)
        return texture

    def _behind(self, state: StudioState, size: tuple[int, int], picture: moderngl.Texture | None) -> None:
        """Background and exposure; a picture that cannot be read is the gradient."""
        program, stage = self._program, state.stage
        red, green, blue, alpha = state.background
        program["u_backdrop"] = BACKDROPS.index(
            GRADIENT if stage.backdrop == PICTURE and not picture else stage.backdrop
        )
        program["u_background"] = (alpha * red, alpha * green, alpha * blue, alpha)
        program["u_top"], program["u_bottom"], program["u_gain"] = stage.top, stage.bottom, stage.gain
        wide = picture.width / picture.height * size[1] / size[0] if picture else 1.0
        program["u_part"] = (min(1 / wide, 1.0), min(wide, 1.0))

    def _on_floor(self, scene: Scene, size: tuple[int, int]) -> None:
        program, stage, camera = self._program, scene.state.stage, scene.camera
        light = stage.light
        program["u_has_floor"] = bool(light and light.floor)
        if light is None:
            return
        pixel_from_uv = np.diag([camera.width, camera.height, 1.0])
        ray = camera.camera_from_world[:3, :3].T @ np.linalg.inv(camera.intrinsics) @ pixel_from_uv
        program["u_ray_from_uv"] = tuple(ray.T.ravel().tolist())
        program["u_eye"] = tuple(camera.centre.tolist())
        program["u_height"], program["u_shadow"] = light.height, light.shadow
        program["u_pool"] = (*scene.state.place, POOL * (stage.backdrop != PICTURE))

    def _uploaded(self, floor: FloorLight) -> moderngl.Texture:
        """The exact picture's map of the floor."""
        if self._floor is None or self._floor[0] is not floor:
            release(self._floor[1] if self._floor else None)
            texture = self._context.texture(floor.values.shape[1::-1], 2, floor.values.tobytes(), alignment=1)
            texture.repeat_x = texture.repeat_y = False
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self._floor = floor, texture
        return self._floor[1]

    def _read(self, path: str) -> moderngl.Texture | None:
        """The background's picture, read once; None, said once, where it cannot be."""
        if self._picture[0] != path:
            release(self._picture[1])
            self._picture = path, None
            try:
                pixels = read_pixels(path)
            except InputError as error:
                log.error("%s", error)
                return None
            texture = self._context.texture(pixels.shape[1::-1], 3, pixels.tobytes(), alignment=1)
            texture.repeat_x = texture.repeat_y = False
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self._picture = path, texture
        return self._picture[1]

    def release(self) -> None:
        """Give everything back."""
        self._canvas.release()
        release(self._floor[1] if self._floor else None, self._picture[1], self._triangle, self._program, self._nothing)
