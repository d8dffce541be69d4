"""How far a surface is from the exact frame: pictures of level `live` against `quality`, and of `balanced` for comparison.

The poses are drawn like those that it was fitted to, from another seed, with expressions: none of them was fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.distil.poses import fitting_poses
from avatarrex.frame import Frame
from avatarrex.gl.context import gl_unavailable
from avatarrex.levels import level
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose import pose_surface
from avatarrex.surface.surface import Surface

FRAMES, SEED = 6, 1
SIDE = 384
"""Pixels."""
FIELD_OF_VIEW = 30.0
"""Degrees."""


def surface_errors(avatar: Avatar, surface: Surface, frames: int = FRAMES) -> dict[str, float | str]:
    """Medians over `frames` views: depth error (mm, pixels that both meet), silhouette IoU, PSNR (dB, likewise) against `quality`."""
    reason = gl_unavailable()
    if reason:
        return {"errors": f"not measured: {reason}"}
    owner = replace(avatar, surface=surface)
    rows = []
    for signals, camera in unfitted(avatar, surface, frames):
        shown = {name: render_frame(owner, signals, camera, level(name)) for name in ("live", "balanced", "quality")}
        rows.append([compared(shown[name], shown["quality"]) for name in ("live", "balanced")])
    rows = [row for row in rows if np.isfinite(row).all()]
    if not rows:
        return {"errors": "not measured: surface and field have no pixel in common"}
    live, balanced = np.median(np.array(rows), 0)
    names = ("depth_mm", "depth_p99_mm", "iou", "psnr_db")
    found = {f"live.{name}": round(float(value), 4) for name, value in zip(names, live)}
    return {**found, **{f"balanced.{name}": round(float(value), 4) for name, value in zip(names, balanced)}}


def unfitted(avatar: Avatar, surface: Surface, count: int) -> list[tuple[Signals, Camera]]:
    """Poses with expressions that no surface is fitted to, each with a view of the whole person."""
    rng = np.random.default_rng(SEED)
    found = []
    for signals in fitting_poses(count, SEED):
        lively = signals.replace(expression=rng.random(52) * (rng.random(52) < 0.1))
        found.append((lively, whole_person(avatar, surface, lively, float(rng.uniform(0, 360)))))
    return found


def compared(frame: Frame, exact: Frame) -> tuple[float, float, float, float]:
    """Mean and 99th percentile of the depth's error in mm, IoU, and PSNR in dB where both have the person."""
    hit, true = frame.pointmap.hit.numpy(), exact.pointmap.hit.numpy()
    both = hit & true
    if not both.any():
        return float("nan"), float("nan"), 0.0, float("nan")
    depth = 1e3 * np.abs(frame.pointmap.depth.numpy() - exact.pointmap.depth.numpy())[both]
    square = np.square(frame.image.numpy() - exact.image.numpy())[both][:, :3].mean()
    psnr = -10 * np.log10(max(float(square), 1e-12))
    return float(depth.mean()), float(np.quantile(depth, 0.99)), float(both.sum() / (hit | true).sum()), psnr


def whole_person(avatar: Avatar, surface: Surface, signals: Signals, azimuth: float) -> Camera:
    """A square view of the whole person."""
    posed = pose_surface(surface, avatar.person, signals)
    place = posed.world_from_root(signals)
    vertices = posed.vertices @ place[:3, :3].T + place[:3, 3]
    middle = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - middle, axis=1).max())
    distance = 1.05 * radius / np.sin(np.radians(FIELD_OF_VIEW) / 2)
    return Camera.orbit(azimuth, 5, distance, FIELD_OF_VIEW, middle, SIDE, SIDE)
