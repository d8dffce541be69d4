"""Level `live`: the avatar's surface (surface/) posed and drawn, instead of its field.

| stage   | makes                                          | its key: what it depends on                              |
|---------|------------------------------------------------|----------------------------------------------------------|
| surface | vertices, normals, tint (`pose_surface`)       | pose without the root, expression, shape                 |
| raster  | a picture on the graphics card                 | the posed surface, camera in the root frame, parts, light |

Nothing is read back before `image` or `pointmap` is taken. Letters: h w pixels. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters, StageClock
from avatarrex.errors import InputError
from avatarrex.frame import Frame
from avatarrex.gl.context import gl_unavailable
from avatarrex.pointmap.point_map import CoveredPixels, PointMap
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.surface.look import Look
from avatarrex.surface.pose import PosedSurface, pose_surface
from avatarrex.surface.raster import SAMPLES, KeyShadow, Placed, SurfacePicture, draw_surfaces, surface_geometry


@runtime_checkable
class Shine(Protocol):
    """The light of a stage on a surface; equal ones give equal pictures."""

    def __call__(self, placed: Placed, world_from_root: np.ndarray) -> KeyShadow:
        """What of the surface is in it."""


@dataclass(frozen=True, kw_only=True)
class LiveFrame(Frame):
    """A frame of level `live`."""

    posed: PosedSurface
    harmonics: np.ndarray
    """(2, 8, 3), the avatar's light in the root frame, on body and hands, and on the face."""
    picture: SurfacePicture
    """In the OpenGL context that was in use."""
    look: Look | Shine | None = None
    """What the picture shows instead of colours, or the light on them."""

    @cached_property
    def image(self) -> Float32[Tensor, "h w 4"]:
        """Premultiplied sRGB-encoded colour and coverage, row 0 at the top; read back at first use."""
        return torch.from_numpy(self.picture.read())

    @cached_property
    def pointmap(self) -> PointMap:
        """Where the rays meet the surface; drawn and read back at first use.

        Of a pixel that is covered in part and not at its centre, a neighbour's point is taken where one is hit.
        """
        found, alpha = surface_geometry(self.posed, self.view, self.settings.hidden), self.image[..., 3].numpy()
        source = _nearest_hit(found.hit, alpha > 0)
        pixel = np.flatnonzero(source >= 0)
        at = source.ravel()[pixel]

        def covered(values: np.ndarray) -> Tensor:
            return torch.from_numpy(values.reshape(alpha.size, *values.shape[2:])[at])

        return CoveredPixels(
            pixel=torch.from_numpy(pixel),
            position=covered(found.position),
            normal=covered(found.normal),
            part_weight=covered(found.part),
            hit=torch.from_numpy(found.hit.ravel()[pixel]),
            coverage=torch.from_numpy(alpha.ravel()[pixel]),
        ).scatter(self.view, f"OpenGL triangles, {self.picture.renderer}", {})


def render_live(
    avatar: Avatar,
    signals: Signals,
    camera: Camera,
    settings: RenderSettings,
    previous: Frame | None = None,
    look: Look | Shine | None = None,
) -> LiveFrame:
    """`avatar`'s surface under `signals` seen by `camera`, `look`: as what, or in which light; see `render_frame`.

    Raises `InputError` for an avatar without a surface, and where there is no OpenGL 4.3.
    """
    if avatar.surface is None:
        raise InputError("level live", "avatar", "a surface, which `avatarrex-studio distil AVATAR` makes", "none")
    reason = gl_unavailable()
    if reason:
        raise InputError("level live", "", "OpenGL 4.3", reason)
    clock, counters = StageClock(), Counters()
    old = previous if isinstance(previous, LiveFrame) else None
    with clock("surface"):
        posed = pose_surface(avatar.surface, avatar.person, signals, old.posed if old else None, counters)
    world_from_root = posed.world_from_root(signals)
    with clock("raster"):
        placed = Placed(
            posed, harmonics_of(avatar, world_from_root), camera.seen_from(world_from_root), settings.hidden
        )
        if old is not None and old.look == look and _same(old, placed, world_from_root, settings):
            picture = old.picture
        else:
            shown = {"key": look(placed, world_from_root)} if isinstance(look, Shine) else {"look": look}
            picture = draw_surfaces([replace(placed, **shown)], SAMPLES if settings.antialias else 1, counters)
    return LiveFrame(
        signals=signals,
        camera=camera,
        settings=settings,
        world_from_root=world_from_root,
        ms=clock.milliseconds(),
        counters=counters.as_dict(),
        notes=(f"triangles: {picture.renderer}",),
        device=avatar.device,
        posed=posed,
        harmonics=placed.harmonics,
        picture=picture,
        look=look,
    )


def harmonics_of(avatar: Avatar, world_from_root: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "2 8 3"]:
    """The avatar's light in the root frame, as surfaces are drawn in it, on body and hands, and on the face; float64."""
    light = avatar.light.over(world_from_root)
    both = (light.harmonics, torch.zeros_like(light.harmonics) if light.face is None else light.face)
    return np.asarray(torch.stack(both).detach().double().cpu().numpy())


def _same(old: LiveFrame, placed: Placed, world_from_root: np.ndarray, settings: RenderSettings) -> bool:
    """Whether the old picture is the new one, in the same light."""
    return (
        old.posed is placed.posed
        and old.view.key() == placed.view.key()
        and (old.settings.hidden, old.settings.antialias) == (settings.hidden, settings.antialias)
        and np.array_equal(old.harmonics, placed.harmonics)
        and (not isinstance(old.look, Shine) or np.array_equal(old.world_from_root, world_from_root))
    )


def _nearest_hit(hit: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(h, w) index of the pixel whose point each hit or covered pixel takes: its own or a neighbour's; −1: none."""
    height, width = hit.shape
    index = np.pad(np.where(hit, np.arange(hit.size).reshape(hit.shape), -1), 1, constant_values=-1)
    source = index[1:-1, 1:-1].copy()
    for y, x in ((0, 1), (1, 0), (1, 2), (2, 1), (0, 0), (0, 2), (2, 0), (2, 2)):
        source = np.where((source < 0) & covered, index[y : y + height, x : x + width], source)
    return source
