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
from avatarrex.live import harmonics_of
from avatarrex.measure.bench.contest import Times, timed
from avatarrex.measure.bench.motion import WARM, Change, everything, turning
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.rivals import fitted_mesh, psnr, unseen
from avatarrex.measure.bench.session import Bench
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.metrics.mesh_surface import mesh_surface
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose import PosedSurface, pose_surface
from avatarrex.surface.raster import Placed, draw_surfaces
from avatarrex.surface.surface import Correction, Surface

BONES = 4
"""Of a vertex in a game engine."""
CROWDS = (1, 2, 4, 8)
"""How many avatars are drawn in one picture."""
WIDTH = 1.6
"""Metres of the camera's distance for each avatar in a row, a metre apart, with a view of 40 degrees."""
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
    errors, large, larger = bench.once(against_quality), bench.side(512, 512), bench.side(1024, 1024)
    owners = {"live": avatar, "clothed_mesh": replace(avatar, surface=four_bones(avatar.surface))}
    lines: tuple[tuple[str, str, int, Change, float | None], ...] = (
        ("live_512_fps", "live", large, everything, 60.0),
        ("live_1024_fps", "live", larger, everything, 25.0),
        ("live_view_512_fps", "live", large, turning, 100.0),
        ("rival.clothed_mesh_512_fps", "clothed_mesh", large, everything, None),
    )
    return [
        *_fitted(bench, large),
        *(
            Metric(f"frame.{name}", rate(bench, owners[who], size, change), "fps", "higher", errors[who], target)
            for name, who, size, change, target in lines
        ),
        *crowds(bench, large),
    ]


def _fitted(bench: Bench, size: int) -> list[Metric]:
    """The textured template whose skin was fitted to the mattes, drawn as the others are, and its picture beside the avatar's."""
    mesh, truth = bench.once(fitted_mesh), bench.once(unseen)
    assert mesh is not None, "there is OpenGL"
    assert truth is not None
    owner = replace(bench.avatar, person=mesh.mesh.person, surface=four_bones(mesh_surface(mesh)))
    error = {**_against_a_picture(bench, owner), "pose": "not seen"}
    for name in ("live", "balanced"):
        drawing = AvatarDrawer(bench.avatar, settings=level(name)).draw(truth[0], bench.camera(len(truth[1])))
        error[f"{name}_psnr_db"] = psnr(drawing, truth[1])
    fps = rate(bench, owner, size, everything)
    return [Metric("frame.rival.fitted_template_512_fps", fps, "fps", "higher", error)]


def crowds(bench: Bench, size: int) -> list[Metric]:
    """Pictures a second of several avatars beside each other in one, everything new in each of them and in the view."""
    found = []
    for number in CROWDS:
        times = Times()
        previous: tuple[PosedSurface, ...] = ()
        for k in range(bench.count(30, 10) + WARM):
            previous, took = timed(crowd, bench, number, k, size, previous)
            if k >= WARM:
                times.add(took)
        error = {"avatars": number, "triangles": number * len(previous[0].surface.faces)}
        found.append(Metric(f"frame.live_{number}_avatars_512_fps", 1e3 / times.ms, "fps", "higher", error))
    return found


def crowd(
    bench: Bench, number: int, frame: int, size: int, previous: tuple[PosedSurface, ...] = ()
) -> tuple[PosedSurface, ...]:
    """Pose `number` avatars in a row and draw them in one picture that the graphics card is done with."""
    avatar, distance = bench.placed, max(2.6, WIDTH * number)
    assert avatar.surface is not None
    camera = Camera.orbit(20 * np.sin(frame), 5, distance, 40, (0, -0.05, 0), size, size)
    placed = []
    for k in range(number):
        signals = everything(bench, frame + 5 * k)[0].replace(translation=np.array([k - (number - 1) / 2, 0, 0]))
        posed = pose_surface(avatar.surface, avatar.person, signals, previous[k] if previous else None)
        place = posed.world_from_root(signals)
        placed.append(Placed(posed, harmonics_of(avatar, place), camera.seen_from(place)))
    draw_surfaces(placed)
    with current_context() as context:
        context.finish()
    return tuple(one.posed for one in placed)


def four_bones(surface: Surface) -> Surface:
    """The same mesh, texture and expressions as a game engine has them."""
    weight = surface.weight[:, :BONES]
    weight = weight / weight.sum(1, keepdims=True)
    return replace(surface, joint=surface.joint[:, :BONES], weight=weight, correction=Correction.none(len(weight)))


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


def against_quality(bench: Bench) -> dict[str, dict[str, Any]]:
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
