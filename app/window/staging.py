"""The picture on its stage, drawn in the window: exact picture over surface over floor over background (`shaders/window/stage.frag`)."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.window.canvas import Canvas, release
from avatarrex_studio.window.layers import Layers

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.gl.shader import draw_program
from avatarrex.stage.composite import POOL, POOL_RADIUS
from avatarrex.stage.picture import Stamp, read_picture, stamp
from avatarrex.stage.stage import BACKDROPS, GRADIENT, PICTURE, KeyLight
from avatarrex.surface.floor import FADE, KEY, SKY, FloorLight
from avatarrex.surface.shadow import SurfaceShadow

log = logging.getLogger(__name__)
CONSTANTS = {"FADE": FADE, "KEY": KEY, "SKY": SKY, "POOL_RADIUS": POOL_RADIUS}


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
        self._programs: dict[tuple[int, ...], tuple[moderngl.Program, moderngl.VertexArray]] = {}
        """By what they draw: pictures, maps of the floor, whether there is a floor, background."""
        self._floor: tuple[FloorLight, moderngl.Texture] | None = None
        self._picture: tuple[Stamp, moderngl.Texture | None] = (("", 0), None)

    def draw(self, layers: Layers, scene: Scene) -> moderngl.Texture:
        """Straight-alpha sRGB bytes, (width, height); the same texture as long as the size stays."""
        stage, shadow, exact = scene.state.stage, scene.surface_floor, scene.exact_floor
        picture = self._read(stage.picture) if stage.backdrop == PICTURE else None
        light = stage.light
        has_floor = light is not None and light.floor
        textures = {
            "u_surface": layers.surface,
            "u_exact": layers.exact,
            "u_surface_floor": shadow.texture if shadow and has_floor else None,
            "u_exact_floor": self._uploaded(exact) if exact and has_floor else None,
            "u_picture": picture,
        }
        given = [texture is not None for texture in textures.values()]
        backdrop = GRADIENT if stage.backdrop == PICTURE and not picture else stage.backdrop
        kind = (given[0] + 2 * given[1], given[2] + 2 * given[3], int(has_floor), BACKDROPS.index(backdrop))
        program, triangle = self._program(kind)
        values = self._behind(scene.state, layers.size, picture) | {"u_weight": layers.weight}
        values |= _on_floor(scene, light) if light else {}
        for unit, (name, texture) in enumerate(textures.items()):
            if texture is not None:
                texture.use(unit)
                values[name] = unit
        for name, value in values.items():
            if name in program:
                program[name] = value
        with self._canvas.drawing(layers.size) as drawn:
            triangle.render(moderngl.TRIANGLES, vertices=3)
        return drawn

    def _program(self, kind: tuple[int, ...]) -> tuple[moderngl.Program, moderngl.VertexArray]:
        """The one that draws such a scene."""
        if kind not in self._programs:
            chosen = CONSTANTS | dict(zip(("PICTURES", "MAPS", "HAS_FLOOR", "BACKDROP"), kind))
            program = draw_program(self._context, "window/whole.vert", "window/stage.frag", chosen)
            self._programs[kind] = program, self._context.vertex_array(program, [])
        return self._programs[kind]

    def _behind(self, state: StudioState, size: tuple[int, int], picture: moderngl.Texture | None) -> dict[str, Any]:
        """Background and exposure, by uniform."""
        stage = state.stage
        red, green, blue, alpha = state.background
        wide = picture.width / picture.height * size[1] / size[0] if picture else 1.0
        part = (min(1 / wide, 1.0), min(wide, 1.0))
        return {
            "u_background": (alpha * red, alpha * green, alpha * blue, alpha),
            "u_top": stage.top,
            "u_bottom": stage.bottom,
            "u_gain": stage.gain,
            "u_part": part,
            "u_picture_level": max(math.log2(part[0] * picture.width / size[0]), 0.0) if picture else 0.0,
        }

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
        """The background's picture, read once as long as its file stays; None, said once, where it cannot be."""
        if self._picture[0] != stamp(path):
            release(self._picture[1])
            self._picture = stamp(path), None
            try:
                pixels = read_picture(self._picture[0])
            except InputError as error:
                log.error("%s", error)
                return None
            texture = self._context.texture(pixels.shape[1::-1], 3, pixels.tobytes(), alignment=1)
            texture.repeat_x = texture.repeat_y = False
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self._picture = self._picture[0], texture
        return self._picture[1]

    def release(self) -> None:
        """Give everything back."""
        self._canvas.release()
        release(self._floor[1] if self._floor else None, self._picture[1])
        for program, triangle in self._programs.values():
            release(triangle, program)


def _on_floor(scene: Scene, light: KeyLight) -> dict[str, Any]:
    """The floor and its maps, by uniform."""
    camera, stage = scene.camera, scene.state.stage
    pixel_from_uv = np.diag([camera.width, camera.height, 1.0])
    ray = camera.camera_from_world[:3, :3].T @ np.linalg.inv(camera.intrinsics) @ pixel_from_uv
    return {
        "u_ray_from_uv": tuple(ray.T.ravel().tolist()),
        "u_eye": tuple(camera.centre.tolist()),
        "u_height": light.height,
        "u_shadow": light.shadow,
        "u_pool": (*scene.state.middle, POOL * (stage.backdrop != PICTURE)),
        "u_surface_region": scene.surface_floor.region if scene.surface_floor else None,
        "u_exact_region": scene.exact_floor.region if scene.exact_floor else None,
    }
