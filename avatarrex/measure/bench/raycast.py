"""Stage `raycast`: rays against the avatar's stored volume, judged by the float64 walk through every cell, per view.

Compared with a march in quarter voxels (KinectFusion's, linear at the end) and plain sphere tracing to 1e-4 m: compute shaders
of their own (shaders/pointmap/plain.comp) on the same textures. In software the processor time of all threads is compared.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import torch

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.gl.context import gl_context, gl_unavailable, in_software, renderer_name
from avatarrex.measure.bench.contest import Contest, Contestant, Goal, interleaved
from avatarrex.measure.bench.raycast_peers import add_mitsuba, ray_error, truth
from avatarrex.measure.bench.report import FASTER, SLOWER, Metric
from avatarrex.measure.bench.session import Bench
from avatarrex.pointmap.raycast_gl import BOXES, GlCaster, gl_caster, march_passes
from avatarrex.pointmap.raycast_torch import raycast_torch
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.settings import RenderSettings
from avatarrex.volume.build import build_volume
from avatarrex.volume.sdf_volume import SdfVolume

ORBITS = ((20, 10, 2.6, 40), (75, -20, 2.2, 45), (200, 35, 3.0, 40))
"""Azimuth, elevation, distance, field of view."""
GOALS = (
    Goal("raycast.vs_quarter_march", "quarter_march", FASTER, 10.0),
    Goal("raycast.vs_sphere", "sphere_tracing", SLOWER, 1.2),
)
Passes = list[tuple[str, int | None, dict[str, int]]]


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    found = bench.once(contests)
    by_view = {contest.case: contest.best.error for contest in found}
    hits = sum(error["hits"] for error in by_view.values())
    wrong = sum(error["missed"] + error["false"] for error in by_view.values())
    mean = max(error["mean_error_mm"] for error in by_view.values())
    p99 = max(error["p99_error_mm"] for error in by_view.values())
    metrics = [
        Metric("raycast.mean_error_mm", mean, "mm", target=1e-3, error=by_view),
        Metric("raycast.p99_error_mm", p99, "mm", target=1e-2, error=by_view),
        Metric("raycast.missed_plus_false", wrong / hits, "of hits", target=1e-5, error={"rays": wrong, "hits": hits}),
    ]
    for goal in GOALS:
        theirs = {contest.case: contest.named[goal.peer].error for contest in found if goal.peer in contest.named}
        metrics += goal.metrics(found, "by_view", ours=by_view, theirs=theirs)
    if missing := gl_unavailable():
        bench.absent |= {goal.name: f"no OpenGL: {missing}" for goal in GOALS}
    return metrics + [metric for contest in found for metric in contest.metrics()]


def contests(bench: Bench) -> list[Contest]:
    """One per view."""
    volume, size = stored_volume(bench), bench.side(512, 192)
    views = ORBITS[:1] if bench.quick else ORBITS
    return [
        _contest(bench, volume, k, Camera.orbit(*view, (0, -0.05, 0), size, size)) for k, view in enumerate(views, 1)
    ]


def stored_volume(bench: Bench) -> SdfVolume:
    """Of the avatar as it stands, at the settings of everyday use."""
    settings = RenderSettings(hidden=bench.avatar.hidden, thin=0)
    return build_volume(bench.avatar, bench.standing, settings, Counters(), None).sdf


def _contest(bench: Bench, volume: SdfVolume, number: int, camera: Camera) -> Contest:
    exact, case = truth(volume, camera), f"raycast.view{number}"
    if gl_unavailable() is not None:
        took = interleaved({"ours_torch": lambda: raycast_torch(volume, camera, False)}, bench.count(3, 2))
        error = ray_error(_torch_distances(volume, camera), exact)
        return Contest(case, (Contestant("ours_torch", took["ours_torch"], error, ours=True),), cpu=True)
    caster = gl_caster()
    runners = {name: partial(_cast, caster, volume, camera, passes) for name, passes in _methods(volume).items()}
    slow = {"quarter_march": runners.pop("quarter_march")}
    times = interleaved(runners, bench.count(7, 5)) | interleaved(slow, 1, warm=bench.quick)
    entries = []
    for name, run in (runners | slow).items():
        run()
        error = ray_error(caster.distances(camera).astype(np.float64), exact)
        entries.append(Contestant(name, times[name], error, ours=name == "ours"))
    add_mitsuba(bench, entries, volume, camera)
    return Contest(case, tuple(entries), cpu=in_software(renderer_name(gl_context())))


def _methods(volume: SdfVolume) -> dict[str, Passes]:
    """Passes of what is compared; each ends with t per pixel in the distance buffer."""
    boxes = BOXES if volume.parts else BOXES[:1]
    ours = march_passes(boxes)
    return {
        "ours": ours,
        "first_pass_alone": [one for one in ours if one[0] != "exact"],
        "sphere_tracing": [("plain", None, {"PARTS": boxes[-1], "METHOD": 1})],
        "quarter_march": [("plain", None, {"PARTS": boxes[-1], "METHOD": 0})],
    }


def _cast(caster: GlCaster, volume: SdfVolume, camera: Camera, passes: Passes) -> None:
    dispatch, _ = caster.prepare(volume, camera, antialias=False)
    for label, over, constants in passes:
        dispatch(label, over, **constants)
    caster.context.finish()


def _torch_distances(volume: SdfVolume, camera: Camera) -> np.ndarray:
    """t of the torch raycast's hits along the rays of `truth`."""
    found = raycast_torch(volume, camera, False)
    rays = RayPlane.of(camera, volume.middle).rays(pixel_centres(camera, torch.float64))
    position = found.position.reshape(-1, 3).double()
    t = ((position - rays.origin) * rays.direction).sum(-1)
    return np.asarray(torch.where(found.hit.reshape(-1), t, torch.inf))
