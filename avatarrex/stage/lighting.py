"""A frame in the light of a stage: its figure shaded, and the floor about it, both from the frame's own volume.

    figure: colour · (1 − FIGURE · shadow · (1 − brightness))       floor: `FloorLight`, for `composite.py`

Letters: h w pixels, p points. Root frame but where the world is said, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.frame import DeferredFrame
from avatarrex.live import LiveFrame
from avatarrex.stage.distance import DistanceGrid, distance_grid
from avatarrex.stage.stage import KeyLight
from avatarrex.stage.visibility import Cone, visibility
from avatarrex.surface.floor import FIGURE, FloorLight, box_corners, brightness, floor_region, texel_centres
from avatarrex.surface.raster import SAMPLES, KeyShadow, Placed, draw_surfaces
from avatarrex.surface.shadow import Caster, SurfaceShadow, draw_shadow
from avatarrex.volume.body_grid import BOX_MARGIN

SIDE = 192
"""Texels along a side of the floor's map: 12 mm of a person's shadow."""
FLOOR_START, FIGURE_START = 0.003, 0.012
"""Metres off the surface at which cones begin: a floor is exact, a figure is as far as its voxels are."""
SURFACE_SKY = 0.88
"""Share of the sky that a surface's vertices are taken to see: the mean of the exact figure's over six poses."""


@dataclass(frozen=True, eq=False)
class Lit:
    """A figure in the light of a stage."""

    image: Float[Tensor, "h w 4"]
    """Premultiplied, sRGB-encoded."""
    floor: FloorLight | None
    """None where there is no floor."""


def lit(frame: DeferredFrame, light: KeyLight, impl: str = "auto") -> Lit:
    """`frame` in the light; see `visibility` for `impl`."""
    grid, world = distance_grid(frame.volume.sdf), frame.world_from_root
    direction = world[:3, :3].T @ light.direction
    found = frame.pointmap
    pixel = torch.nonzero(found.coverage.reshape(-1) > 0)[:, 0]
    points, normals = (values.reshape(-1, 3)[pixel].float().cpu() for values in (found.position, found.normal))
    seen = visibility(grid, points, normals, Cone(direction, light.width), FIGURE_START, impl).numpy()
    gain = torch.ones(found.coverage.numel())
    gain[pixel] = torch.from_numpy(figure_gain(seen, light.shadow).astype(np.float32))
    image = frame.image.float().cpu().clone()
    image[..., :3] *= gain.view(*found.coverage.shape, 1)
    return Lit(image, floor_light(grid, world, light, impl) if light.floor else None)


def figure_gain(seen: Float[np.ndarray, "p 2"], shadow: float) -> Float[np.ndarray, " p"]:
    """What a figure's colours are multiplied by where so much of key light and sky is seen."""
    return np.asarray(1 - FIGURE * shadow * (1 - brightness(seen)))


def floor_light(
    grid: DistanceGrid, world_from_root: np.ndarray, light: KeyLight, impl: str = "auto", side: int = SIDE
) -> FloorLight:
    """The floor's map under what `grid` contains."""
    extent = grid.voxel * (np.array(grid.values.shape[::-1]) - 1)
    bounds = np.stack([grid.origin + BOX_MARGIN, grid.origin + extent - BOX_MARGIN])
    region = floor_region(box_corners(bounds, world_from_root), light.direction, light.height)
    world = texel_centres(region, light.height, side)
    turn, place = world_from_root[:3, :3], world_from_root[:3, 3]
    points = torch.from_numpy(((world - place) @ turn).astype(np.float32))
    up, direction = turn.T @ np.array([0.0, 1.0, 0.0]), turn.T @ light.direction
    normals = torch.from_numpy(up.astype(np.float32)).expand_as(points)
    seen = visibility(grid, points, normals, Cone(direction, light.width), FLOOR_START, impl).numpy()
    return FloorLight(region, np.rint(255 * seen.clip(0, 1)).astype(np.uint8).reshape(side, side, 2))


@dataclass
class SurfaceLight:
    """A stage's light on the surface of level `live`, for `render_live`; the shadow is drawn anew where its caster is another one."""

    light: KeyLight
    shadow: SurfaceShadow | None = field(default=None, compare=False)
    """On the floor, the last one."""
    _caster: Caster | None = field(default=None, compare=False)

    def __call__(self, placed: Placed, world_from_root: np.ndarray) -> KeyShadow:
        """What of a surface with that root is in the light."""
        caster, old, light = Caster(placed.posed, world_from_root, placed.hidden), self._caster, self.light
        same = old and old.posed is caster.posed and old.hidden == caster.hidden
        if not (self.shadow and old and same and np.array_equal(old.world_from_root, world_from_root)):
            self.shadow, self._caster = draw_shadow([caster], light.direction, light.width, light.height), caster
        dark, bright = figure_gain(np.array([[0.0, SURFACE_SKY], [1.0, SURFACE_SKY]]), light.shadow).tolist()
        direction = world_from_root[:3, :3].T @ light.direction
        mapped = self.shadow.map_from_world @ world_from_root
        return KeyShadow(self.shadow.heights, mapped, direction, (dark, bright - dark))


def lit_surface(frame: LiveFrame, light: KeyLight) -> Lit:
    """A frame of level `live` in the light, drawn anew and read back."""
    shine = SurfaceLight(light)
    placed = Placed(frame.posed, frame.harmonics, frame.view, frame.settings.hidden)
    placed = replace(placed, key=shine(placed, frame.world_from_root))
    picture = draw_surfaces([placed], SAMPLES if frame.settings.antialias else 1)
    assert shine.shadow is not None
    return Lit(torch.from_numpy(picture.read()), shine.shadow.read() if light.floor else None)
