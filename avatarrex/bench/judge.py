"""How far is a frame from the exact one? The one place that says what the levels are judged by.

The body's field itself, not a grid of it, is sampled every `STEP` metres along each ray and its first crossing bisected;
hands and face are read from boxes finer than any level's (as fine as everyday ones in a quick run). Small images. Letters: r rays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pipeline import Frame, RenderSettings, render_frame
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.signals.signals import Signals
from avatarrex.templates.posed import pose_person
from avatarrex.training.frames import TrainingFrame
from avatarrex.training.sampling import span
from avatarrex.training.trained_field import TrainedBody
from avatarrex.volume.build import build_volume

STEP = 0.004
NEAR = 0.075
"""Metres from the skin beyond which there is no surface: cloth and what a field may differ from it."""
FINE, COARSE = 0.00125, 0.0025
"""Metres between the voxels of the boxes."""
CHUNK = 40_000


@dataclass(frozen=True)
class Exact:
    """One exact frame."""

    signals: Signals
    camera: Camera
    t: np.ndarray
    """(r,) metres along the pixels' rays, +inf where they miss."""
    image: Tensor
    """(h, w, 3) sRGB, black where nothing is hit."""


@torch.no_grad()
def exact_frame(avatar: Avatar, signals: Signals, camera: Camera, part_voxel: float = FINE) -> Exact:
    """What every level of `avatar` should show."""
    posed = pose_person(avatar.person, signals, Counters(), None)
    volume = build_volume(avatar, posed, RenderSettings(part_voxel=part_voxel, hidden=avatar.hidden), Counters(), None)
    world_from_root = posed.world_from_root(signals)
    planes = {} if volume.views is None else {"colour": avatar.face.colour_planes(volume.views)}
    frame = TrainingFrame(0, posed, world_from_root, volume.probe, volume, 0, planes)
    field = TrainedBody(avatar, frame, volume.body_frame)
    view = camera.seen_from(world_from_root)
    rays = RayPlane.of(view, volume.sdf.middle).rays(pixel_centres(view))

    def value(position: Tensor) -> Tensor:
        return torch.cat([field.composed(some).sdf for some in position.split(CHUNK)])

    entry, exit = span(volume.sdf, rays)
    t = torch.full_like(entry, torch.inf)
    for rows in torch.nonzero(exit > entry)[:, 0].split(1024):
        count = int(((exit - entry)[rows].max() / STEP).ceil()) + 2
        along = entry[rows, None] + STEP * torch.arange(count)
        place = rays.origin[rows, None] + along[..., None] * rays.direction[rows, None]
        near = np.abs(volume.probe.query(place.reshape(-1, 3).double().numpy()).guess) < NEAR
        sdf = torch.full((along.numel(),), NEAR)
        sdf[torch.from_numpy(near)] = value(place.reshape(-1, 3)[torch.from_numpy(near)])
        sdf = sdf.reshape(along.shape)
        falls = (sdf[:, :-1] >= 0) & (sdf[:, 1:] < 0)
        some = torch.nonzero(falls.any(1))[:, 0]
        low = along[some, falls[some].int().argmax(1)]
        high, chosen = low + STEP, rays[rows[some]]
        for _ in range(16):
            middle = (low + high) / 2
            outside = value(chosen.at(middle)) >= 0
            low, high = torch.where(outside, middle, low), torch.where(outside, high, middle)
        t[rows[some]] = (low + high) / 2
    hit = torch.nonzero(t.isfinite())[:, 0]
    position = rays[hit].at(t[hit])
    image = torch.zeros(len(t), 3)
    image[hit] = field.paint().colour(position, rays[hit].direction, field.composed(position).part_weight)
    return Exact(signals, camera, t.double().numpy(), image.reshape(camera.height, camera.width, 3))


def judged(frame: Frame, exact: Exact) -> dict[str, Any]:
    """Errors of a frame of the same signals and camera, rendered without antialiasing."""
    view = frame.camera.seen_from(frame.world_from_root)
    rays = RayPlane.of(view, frame.volume.sdf.middle).rays(pixel_centres(view, torch.float64))
    position = frame.pointmap.position.reshape(-1, 3).double()
    t = ((position - rays.origin) * rays.direction).sum(-1).numpy()
    seen, truth = frame.pointmap.hit.reshape(-1).numpy(), np.isfinite(exact.t)
    both = seen & truth
    error = 1e3 * np.abs(t[both] - exact.t[both])
    colour = (frame.image[..., :3] - exact.image).reshape(-1, 3)[torch.from_numpy(both)]
    return {
        "depth_mean_mm": float(error.mean()),
        "depth_p99_mm": float(np.quantile(error, 0.99)),
        "depth_max_mm": float(error.max()),
        "flips": float(np.sum(seen != truth) / max(np.sum(seen | truth), 1)),
        "psnr_db": float(-10 * torch.log10(colour.square().mean())),
        "pixels": int(both.sum()),
    }


def error_of(avatar: Avatar, settings: RenderSettings, exact: Exact) -> dict[str, Any]:
    """Of a level."""
    plain = replace(settings, antialias=False)
    return judged(render_frame(avatar, exact.signals, exact.camera, plain), exact)
