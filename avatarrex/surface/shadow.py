"""The floor's light under posed surfaces, drawn by OpenGL in whichever context is in use: what level `live` shows of a stage.

1. The surfaces are drawn along the rays of the key light onto the floor; a map keeps the least height of each ray, and the greatest.
2. Each texel of the floor looks for what is above it within the light's disc; their mean height says how soft the shadow is
   (Fernando, 'Percentage-closer soft shadows'). The sky is hidden by spheres (spheres.py).

The greatest height says which vertices of a figure are in the light (`KeyShadow`). Nothing is read back before `read`.
World frame, metres.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np
from jaxtyping import Float

from avatarrex.counters import Counters
from avatarrex.gl.context import current_context, per_context
from avatarrex.gl.shader import draw_program
from avatarrex.surface.floor import FloorLight, Region, box_corners, floor_region, span
from avatarrex.surface.pose import PosedSurface
from avatarrex.surface.raster import Raster, target_kept
from avatarrex.surface.spheres import MOST, Spheres

RAYS, SIDE = 192, 112
"""Texels along a side of the light's map and of the floor's, under one figure."""
MOST_TIMES, STEP = 3.0, 0.25
"""How many times as many where figures stand apart, so that the texels of each stay as small, at most; and in which steps."""
TAPS = 14
TALLEST = 2.6
"""Metres over the floor: what is higher softens no shadow any more."""
MOST_SPHERES = 8 * MOST
"""Of all casters: of further ones the sky is not hidden. Every OpenGL 4.3 has room for 256 in a shader."""
NOTHING = 1e4
"""Height of a ray that meets nothing."""


@dataclass(frozen=True, eq=False)
class Caster:
    """A posed surface that throws a shadow."""

    posed: PosedSurface
    world_from_root: Float[np.ndarray, "4 4"]
    hidden: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class SurfaceShadow:
    """A floor's light in a context. When nobody has it any more, its texture serves another one."""

    region: Region
    texture: moderngl.Texture
    """RG8, (x, z): key light and sky."""
    heights: moderngl.Texture
    """The light's map."""
    map_from_world: Float[np.ndarray, "4 4"]
    """(u, v, height) of a world point in `heights`."""

    def read(self) -> FloorLight:
        """The map in memory."""
        with current_context():
            data = self.texture.read(alignment=1)
        width, height = self.texture.size
        return FloorLight(self.region, np.frombuffer(data, np.uint8).reshape(height, width, 2))


def draw_shadow(
    casters: Sequence[Caster], direction: Float[np.ndarray, "3"], width: float, height: float
) -> SurfaceShadow:
    """The light on the floor y = `height`, from `direction` (unit, towards it), tangent of its radius `width`.

    At least one caster. Raises `NoContext` without OpenGL 4.3.
    """
    with current_context() as context:
        raster = per_context(context, Raster, lambda: Raster(context))
        floor = per_context(context, _Floor, lambda: _Floor(context))
        corners = [box_corners(one.posed.bounds, one.world_from_root) for one in casters]
        alone = max(span(floor_region(own, direction, height)) for own in corners)
        region = floor_region(np.concatenate(corners), direction, height)
        times = min(max(math.ceil(span(region) / alone / STEP - 1e-6) * STEP, 1.0), MOST_TIMES)
        return floor.draw(raster, casters, Extent(region, height, times), direction, width)


@dataclass(frozen=True)
class Extent:
    """What of a floor has a map."""

    region: Region
    height: float
    times: float
    """Texels along a side, times those of one figure."""


class _Floor:
    """What one context draws shadows with."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        constants = {"TAPS": TAPS, "TALLEST": TALLEST, "MOST_SPHERES": MOST_SPHERES}
        self._program = draw_program(context, "window/whole.vert", "surface/floor.frag", constants)
        self._soften = draw_program(context, "window/whole.vert", "surface/soften.frag")
        self._triangles = [context.vertex_array(program, []) for program in (self._program, self._soften)]
        self._free: dict[float, list[tuple[moderngl.Texture, moderngl.Texture, moderngl.Texture]]] = {}
        """The light's map, the floor's before it is softened and after, of shadows that are no more, by `Extent.times`."""

    def draw(
        self,
        raster: Raster,
        casters: Sequence[Caster],
        extent: Extent,
        direction: np.ndarray,
        width: float,
    ) -> SurfaceShadow:
        """See `draw_shadow`."""
        mapped = _map_from_world(extent.region, direction, extent.height)
        free = self._free.setdefault(extent.times, [])
        rays, side = (round(each * extent.times) for each in (RAYS, SIDE))
        made = free.pop() if free else (self._heights(rays), self._floor(side), self._floor(side))
        heights, rough, texture = made
        with target_kept(self._context):
            self._cast(raster, casters, heights, mapped)
            self._place(casters, extent.region, extent.height)
            self._program["u_penumbra"] = tuple(_penumbra(direction, width).T.ravel().tolist())
            self._gather(heights, rough, texture)
        shadow = SurfaceShadow(extent.region, texture, heights, mapped)
        weakref.finalize(shadow, free.append, made).atexit = False
        return shadow

    def _cast(self, raster: Raster, casters: Sequence[Caster], heights: moderngl.Texture, mapped: np.ndarray) -> None:
        """The heights along the light's rays."""
        target = self._target(heights)
        target.use()
        target.clear(NOTHING, NOTHING)
        clip_from_map = np.array([[2, 0, 0, -1], [0, 2, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        counters = Counters()
        for one in casters:
            raster.cast(one.posed, one.hidden, clip_from_map @ mapped @ one.world_from_root, counters)

    def _place(self, casters: Sequence[Caster], region: Region, height: float) -> None:
        """Tell the program where the map lies, and the spheres."""
        program = self._program
        spheres = np.concatenate([_spheres(one) for one in casters])[:MOST_SPHERES]
        spheres[:, :3] -= [region[0], height, region[1]]
        table = np.zeros((MOST_SPHERES, 4), np.float32)
        table[: len(spheres)] = spheres
        uniform = program["u_spheres"]
        assert isinstance(uniform, moderngl.Uniform)
        uniform.write(table)  # quicker than a list of tuples
        program["u_count"] = len(spheres)
        program["u_size"] = (region[2] - region[0], region[3] - region[1])

    def _gather(self, heights: moderngl.Texture, rough: moderngl.Texture, texture: moderngl.Texture) -> None:
        """The floor's texels."""
        heights.use(0)
        self._context.disable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for made, triangle in zip((rough, texture), self._triangles):
            self._target(made).use()
            triangle.render(moderngl.TRIANGLES, vertices=3)
            made.use(0)

    def _target(self, texture: moderngl.Texture) -> moderngl.Framebuffer:
        return per_context(self._context, ("shadow", texture.glo), lambda: self._context.framebuffer([texture]))

    def _heights(self, rays: int) -> moderngl.Texture:
        texture = self._context.texture((rays, rays), 2, dtype="f4")
        texture.repeat_x = texture.repeat_y = False
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def _floor(self, side: int) -> moderngl.Texture:
        texture = self._context.texture((side, side), 2, alignment=1)
        texture.repeat_x = texture.repeat_y = False
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        return texture


def _map_from_world(region: Region, direction: np.ndarray, height: float) -> np.ndarray:
    """(4, 4): a point goes along the light's rays to the floor, the region is [0, 1]²; z is the metres over the floor."""
    across, down = region[2] - region[0], region[3] - region[1]
    lean_x, lean_z = direction[0] / direction[1], direction[2] / direction[1]
    return np.array([
        [1 / across, -lean_x / across, 0, (lean_x * height - region[0]) / across],
        [0, -lean_z / down, 1 / down, (lean_z * height - region[1]) / down],
        [0, 1, 0, -height],
        [0, 0, 0, 1],
    ])  # fmt: skip


def _penumbra(direction: np.ndarray, width: float) -> np.ndarray:
    """(2, 2): x and z on the floor that the light's disc spreads over, for a metre of height: longer away from the light."""
    across = width / direction[1]
    level = direction[[0, 2]]
    length = float(np.linalg.norm(level))
    if length < 1e-6:
        return np.diag([across, across])
    along = level / length
    sideways = np.array([-along[1], along[0]])
    return np.stack([along * across / direction[1], sideways * across], 1)


def _spheres(one: Caster) -> Float[np.ndarray, "n 4"]:
    """World centres and radii."""
    spheres = Spheres.of(one.posed.surface)
    world = one.world_from_root
    centres = spheres.centres(one.posed.vertices) @ world[:3, :3].T + world[:3, 3]
    return np.concatenate([centres, spheres.radius[:, None]], 1)
