"""Level `live` in the stage `frame`, and what a game engine would show of the same person: four bones a vertex, no corrections.

A frame is posed, drawn and finished by the graphics card; nothing is read back. Errors are those against level `quality` in poses
that no surface is fitted to (distil/errors.py); `picture_psnr_db` is against the subject's picture, as the naked template's is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.distil.errors import compared, unfitted
from avatarrex.frame import Frame
from avatarrex.gl.context import current_context, gl_unavailable
from avatarrex.levels import level
from avatarrex.measure.bench.contest import Times, timed
from avatarrex.measure.bench.motion import WARM, Change, everything, turning
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.rivals import psnr, unseen
from avatarrex.measure.bench.session import Bench
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.surface.surface import Surface

BONES = 4
"""Of a vertex in a game engine."""
ERRORS = ("depth_mean_mm", "depth_p99_mm", "iou", "psnr_db")
"""What `compared` gives."""


def of_the_surface(bench: Bench) -> list[Metric]:
    """Rates of `live` and of the clothed mesh; nothing but a note where the avatar has no surface or there is no OpenGL."""
    avatar, why = bench.placed, gl_unavailable()
    if avatar.surface is None:
        why = "the avatar has no surface: `avatarrex-studio distil AVATAR` makes one"
    if avatar.surface is None or why:
        bench.absent.update({"frame.live": str(why), "frame.rival.clothed_mesh": str(why)})
        return []
    errors, large, larger = bench.once(surface_errors), bench.side(512, 512), bench.side(1024, 1024)
    owners = {"live": avatar, "clothed_mesh": replace(avatar, surface=four_bones(avatar.surface))}
    lines: tuple[tuple[str, str, int, Change, float | None], ...] = (
        ("live_512_fps", "live", large, everything, 60.0),
        ("live_1024_fps", "live", larger, everything, 25.0),
        ("live_view_512_fps", "live", large, turning, 100.0),
        ("rival.clothed_mesh_512_fps", "clothed_mesh", large, everything, None),
    )
    return [
        Metric(f"frame.{name}", rate(bench, owners[who], size, change), "fps", "higher", errors[who], target)
        for name, who, size, change, target in lines
    ]


def four_bones(surface: Surface) -> Surface:
    """The same mesh, texture and expressions as a game engine has them."""
    full, weight = surface.correction, surface.weight[:, :BONES]
    low, high, basis = (values[:, :0] for values in (full.low, full.high, full.basis))
    none = replace(full, coefficients=full.coefficients[..., :0], low=low, high=high, basis=basis)
    weight = weight / weight.sum(1, keepdims=True)
    return replace(surface, joint=surface.joint[:, :BONES], weight=weight, correction=none)


def rate(bench: Bench, avatar: Avatar, size: int, change: Change) -> float:
    """Frames of level `live` a second, by the median frame."""
    times, previous = Times(), None
    for k in range(bench.count(60, 20) + WARM):
        signals, azimuth = change(bench, k)
        previous, took = timed(finished, avatar, signals, bench.camera(size, azimuth), previous)
        if k >= WARM:
            times.add(took)
    return 1e3 / times.ms


def finished(avatar: Avatar, signals: Signals, camera: Camera, previous: Frame | None = None) -> Frame:
    """A frame of level `live` that the graphics card is done with."""
    frame = render_frame(avatar, signals, camera, level("live"), previous)
    with current_context() as context:
        context.finish()
    return frame


def surface_errors(bench: Bench) -> dict[str, dict[str, Any]]:
    """Of `live` and `clothed_mesh`: medians of `compared` over the views, how far below `balanced` the worst of them is."""
    avatar, surface = bench.avatar, bench.avatar.surface
    assert surface is not None
    owners = {"live": avatar, "clothed_mesh": replace(avatar, surface=four_bones(surface))}
    side, rows = bench.side(384, 256), []
    for signals, camera in unfitted(avatar, surface, bench.count(12, 3)):
        view = camera.resized(side, side)
        exact, balanced = (render_frame(avatar, signals, view, level(name)) for name in ("quality", "balanced"))
        shown = (render_frame(owner, signals, view, level("live")) for owner in owners.values())
        rows.append([compared(frame, exact) for frame in (*shown, balanced)])
    each = np.array(rows)
    found: dict[str, dict[str, Any]] = {}
    for index, (name, owner) in enumerate(owners.items()):
        medians = dict(zip(ERRORS, map(float, np.median(each[:, index], 0))))
        below = float((each[:, -1, -1] - each[:, index, -1]).max())
        found[name] = {**medians, "below_balanced_db": below, "poses": len(rows), **_against_a_picture(bench, owner)}
    return found


def _against_a_picture(bench: Bench, avatar: Avatar) -> dict[str, float]:
    truth = bench.once(unseen)
    if truth is None:
        return {}
    signals, picture = truth
    drawing = AvatarDrawer(avatar, settings=level("live")).draw(signals, bench.camera(len(picture)))
    return {"picture_psnr_db": psnr(drawing, picture)}
