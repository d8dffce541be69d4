"""Frames in the light of a stage: their figures shaded, and the floor about them, both from the frames' own volumes.

    figure: colour · (1 − FIGURE · shadow · (1 − brightness))       floor: `FloorLight`, for `composite.py`

Letters: h w pixels, p points. Root frame but where the world is said, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.frame import DeferredFrame
from avatarrex.live import LiveFrame
from avatarrex.stage.distance import DistanceGrid, distance_grid
from avatarrex.stage.stage import KeyLight
from avatarrex.stage.visibility import Cone, visibility
from avatarrex.surface.floor import FIGURE, FloorLight, box_corners, brightness, floor_region, span, texel_centres
from avatarrex.surface.raster import SAMPLES, KeyShadow, Placed, draw_surfaces
from avatarrex.surface.shadow import Caster, SurfaceShadow, draw_shadow
from avatarrex.volume.body_grid import BOX_MARGIN

SIDE = 192
"""Texels along a side of the floor's map: 12 mm of a person's shadow."""
MOST_SIDES = 3
"""Times `SIDE`: figures far from each other have coarser shadows."""
FLOOR_START, FIGURE_START = 0.003, 0.012
"""Metres off the surface at which cones begin: a floor is exact, a figure is as far as its voxels are."""
SURFACE_SKY = 0.88
"""Share of the sky that a surface's vertices are taken to see: the mean of the exact figure's over six poses."""

Standing = tuple[DistanceGrid, np.ndarray]
"""A figure: its distances, and `world_from_root` (4, 4)."""
Points = Float[np.ndarray, "p 3"]
_seen: WeakKeyDictionary[DistanceGrid, dict[bytes, np.ndarray]] = WeakKeyDictionary()
"""What each figure leaves of the points that were lit last: those of every figure's picture and of the floor."""


@dataclass(frozen=True, eq=False)
class Lit:
    """Figures in the light of a stage."""

    image: Float[Tensor, "h w 4"]
    """Premultiplied, sRGB-encoded."""
    floor: FloorLight | None
    """None where there is no floor."""


def lit(frames: Sequence[DeferredFrame], light: KeyLight, impl: str = "auto") -> tuple[list[Tensor], FloorLight | None]:
    """The images of `frames` of one picture in the light, which each figure keeps from the others, too, and the floor's.

    None where there is no floor. See `visibility` for `impl`.
    """
    standing = [(distance_grid(frame.volume.sdf), frame.world_from_root) for frame in frames]
    images = []
    for frame in frames:
        found = frame.pointmap
        pixel = torch.nonzero(found.coverage.reshape(-1) > 0)[:, 0]
        points, normals = (
            values.reshape(-1, 3)[pixel].double().cpu().numpy() for values in (found.position, found.normal)
        )
        turn, place = frame.world_from_root[:3, :3], frame.world_from_root[:3, 3]
        seen = seen_light(standing, points @ turn.T + place, normals @ turn.T, light, FIGURE_START, impl)
        gain = torch.ones(found.coverage.numel())
        gain[pixel] = torch.from_numpy(figure_gain(seen, light.shadow).astype(np.float32))
        image = frame.unmixed.float().cpu().clone()
        image[..., :3] *= gain.view(*found.coverage.shape, 1)
        images.append(found.edges.blended(image))
    return images, floor_light(standing, light, impl) if light.floor else None


def seen_light(
    standing: Sequence[Standing],
    points: Float[np.ndarray, "p 3"],
    normals: Float[np.ndarray, "p 3"],
    light: KeyLight,
    start: float,
    impl: str = "auto",
) -> Float[np.ndarray, "p 2"]:
    """What world points with unit normals see of key light and sky among the figures; see `visibility`.

    Of the key light the least that one of the figures leaves, for a light as narrow is hidden or not; of the sky the product. What a
    figure that stays as it is leaves of the same points is remembered: those of the floor are the same in every view, those of another
    figure while that and the view stay.
    """
    seen, cone = np.ones((len(points), 2)), Cone(light.direction, light.width)
    about = blake2b(np.concatenate([points.ravel(), normals.ravel(), light.direction, [light.width, start]]).tobytes())
    about.update(impl.encode())
    for grid, world in standing:
        kept, name = _seen.setdefault(grid, {}), about.digest() + world.tobytes()
        found = kept.pop(name) if name in kept else _of_figure((grid, world), points, normals, cone, start, impl)
        kept[name] = found  # the newest of them
        if len(kept) > len(standing) + 1:
            del kept[next(iter(kept))]
        seen = np.stack([np.minimum(seen[:, 0], found[:, 0]), seen[:, 1] * found[:, 1]], 1)
    return seen


def _of_figure(standing: Standing, points: Points, normals: Points, key: Cone, start: float, impl: str) -> np.ndarray:
    """(p, 2) what one of them leaves."""
    grid, world = standing
    turn, place = world[:3, :3], world[:3, 3]
    own = [torch.from_numpy(v.astype(np.float32)) for v in ((points - place) @ turn, normals @ turn)]
    found = visibility(grid, own[0], own[1], Cone(turn.T @ key.direction, key.width), start, impl)
    return np.asarray(found.numpy())


def figure_gain(seen: Float[np.ndarray, "p 2"], shadow: float) -> Float[np.ndarray, " p"]:
    """What a figure's colours are multiplied by where so much of key light and sky is seen."""
    return np.asarray(1 - FIGURE * shadow * (1 - brightness(seen)))


def floor_light(standing: Sequence[Standing], light: KeyLight, impl: str = "auto", side: int = SIDE) -> FloorLight:
    """The floor's map under figures, of `side` texels where one stands alone, and as fine where several do."""
    corners = [box_corners(_bounds(grid), world) for grid, world in standing]
    alone = [floor_region(own, light.direction, light.height) for own in corners]
    region = floor_region(np.concatenate(corners), light.direction, light.height)
    side = min(round(side * span(region) / max(map(span, alone))), MOST_SIDES * side)
    world = texel_centres(region, light.height, side)
    seen = seen_light(standing, world, np.tile([0.0, 1.0, 0.0], (len(world), 1)), light, FLOOR_START, impl)
    return FloorLight(region, np.rint(255 * seen.clip(0, 1)).astype(np.uint8).reshape(side, side, 2))


def _bounds(grid: DistanceGrid) -> Float[np.ndarray, "2 3"]:
    """Two corners of what a grid contains."""
    extent = grid.voxel * (np.array(grid.values.shape[::-1]) - 1)
    return np.stack([grid.origin + BOX_MARGIN, grid.origin + extent - BOX_MARGIN])


@dataclass
class SurfaceLight:
    """A stage's light on the surface of level `live`, for `render_live`; the shadow is drawn anew where its caster is another one."""

    light: KeyLight
    shadow: SurfaceShadow | None = field(default=None, compare=False)
    """On the floor, the last one."""
    _casters: tuple[Caster, ...] = field(default=(), compare=False)

    def __call__(self, placed: Placed, world_from_root: np.ndarray) -> KeyShadow:
        """What of a surface with that root is in the light."""
        return self.keys([Caster(placed.posed, world_from_root, placed.hidden)])[0]

    def keys(self, casters: Sequence[Caster]) -> list[KeyShadow]:
        """What of each of the surfaces of one picture is in the light."""
        light, old = self.light, self._casters
        if self.shadow is None or len(old) != len(casters) or not all(map(_same, old, casters)):
            self.shadow = draw_shadow(casters, light.direction, light.width, light.height)
            self._casters = tuple(casters)
        dark, bright = figure_gain(np.array([[0.0, SURFACE_SKY], [1.0, SURFACE_SKY]]), light.shadow).tolist()
        mapped, heights = self.shadow.map_from_world, self.shadow.heights
        gains = dark, bright - dark
        worlds = [one.world_from_root for one in casters]
        return [KeyShadow(heights, mapped @ world, world[:3, :3].T @ light.direction, gains) for world in worlds]


def lit_surfaces(frames: Sequence[LiveFrame], light: KeyLight | None) -> Lit:
    """Frames of level `live` in one picture, in the light where there is one; drawn anew and read back."""
    placed = [Placed(frame.posed, frame.harmonics, frame.view, frame.settings.hidden) for frame in frames]
    floor = None
    if light is not None:
        shine = SurfaceLight(light)
        keys = shine.keys([Caster(f.posed, f.world_from_root, f.settings.hidden) for f in frames])
        placed = [replace(one, key=key) for one, key in zip(placed, keys)]
        assert shine.shadow is not None
        floor = shine.shadow.read() if light.floor else None
    picture = draw_surfaces(placed, SAMPLES if frames[0].settings.antialias else 1)
    return Lit(torch.from_numpy(picture.read()), floor)


def _same(old: Caster, new: Caster) -> bool:
    """Whether both throw the same shadow."""
    same_root = np.array_equal(old.world_from_root, new.world_from_root)
    return old.posed is new.posed and old.hidden == new.hidden and same_root
