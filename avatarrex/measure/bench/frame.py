"""Stage `frame`: whole frames of every level, beside volume rendering of the same avatar and a skinned textured mesh.

Frames follow each other as in the studio: the frame before is at hand. Times are what a user waits (wall clock); ratios and
errors come from the same run. Errors of levels: against the oracle's exact frame (reference/error_report.py). Networks run on the session's
device, those of the oracle and of rivals on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from statistics import median
from typing import Any

import numpy as np

from avatarrex.frame import Frame
from avatarrex.levels import DEFERRED_LEVELS, dragged, level
from avatarrex.measure.bench.metric import FASTER, Metric
from avatarrex.measure.bench.rivals import textured_mesh, volume_rendering
from avatarrex.measure.bench.session import Bench
from avatarrex.pipeline import render_frame
from avatarrex.reference.error_report import depth_report
from avatarrex.reference.oracle import render_oracle
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals

JUDGED = 5
"""Frame of the motion that errors are measured in: an arm on its way up."""
EVERYDAY, DRAGGING = "balanced", "fast"
"""Levels that the targets of a whole frame are about."""
WARM = 2
"""Frames that are not counted: shaders are compiled, caches filled."""
LEFT_SHOULDER = 15
"""Row of the body pose."""


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    large, small, drag = bench.side(512, 512), bench.side(256, 256), bench.side(192, 192)
    poses, views = bench.count(6, 2), bench.count(12, 4)
    errors = bench.once(level_errors)
    metrics, new_pose = [], {}
    for name, settings in DEFERRED_LEVELS.items():
        frames = sequence(bench, settings, large, poses, posing(bench))
        new_pose[name] = _total(frames)
        error = {**errors[name], **by_stage(frames)}
        metrics.append(Metric(f"frame.level.{name}.ms", new_pose[name], "ms", error=error))
    turned = _total(sequence(bench, level(EVERYDAY), small, views, turning(bench)))
    drags = sequence(bench, dragged(level(DRAGGING)), drag, views, dragging(bench))
    drag_errors = {**errors["dragged"], **lag(bench, drags[-1]), **by_stage(drags)}
    metrics += [
        Metric("frame.new_pose_512_ms", new_pose[EVERYDAY], "ms", error=errors[EVERYDAY], target=500.0),
        Metric("frame.view_256_fps", 1e3 / turned, "fps", "higher", errors[EVERYDAY], 15.0),
        Metric("frame.drag_fps", 1e3 / _total(drags), "fps", "higher", drag_errors, 10.0),
        Metric("frame.idle_work", idle_work(bench, small), "counts", target=0),
        *of_a_gpu(bench),
        *volume_rendering(bench, large),
        *textured_mesh(bench, large),
    ]
    error = {"ours": errors[EVERYDAY], "paper": errors["paper"]}
    faster = new_pose["paper"] / new_pose[EVERYDAY]
    return [*metrics, Metric("frame.vs_paper_level", faster, FASTER, "higher", error, 3.0)]


def of_a_gpu(bench: Bench) -> list[Metric]:
    """Frames at 1024²; targets are those of one H100: everything changes, and the view alone."""
    size, cuda = bench.side(1024, 1024), bench.device.startswith("cuda")
    error = bench.once(level_errors)[EVERYDAY]
    found = []
    for name, target, count, change in (
        ("new_pose", 120.0, bench.count(6, 2), posing(bench)),
        ("view", 300.0, bench.count(12, 4), turning(bench)),
    ):
        frames = sequence(bench, level(EVERYDAY), size, count, change)
        by = {**error, **by_stage(frames), "networks": frames[-1].device}
        fps = 1e3 / _total(frames)
        found.append(Metric(f"frame.{name}_1024_fps", fps, "fps", "higher", by, target if cuda else None))
    return found


def level_errors(bench: Bench) -> dict[str, dict[str, Any]]:
    """`Accuracy` of every level against the exact frame, 64×64; `dragged`: with the voxels that a limb is dragged with."""
    signals, camera = bench.signals(JUDGED), bench.camera(bench.side(64, 64))
    exact = render_oracle(bench.avatar, signals, camera)
    every = {**DEFERRED_LEVELS, "dragged": dragged(level(DRAGGING))}
    frames = {name: render_frame(bench.placed, signals, camera, settings) for name, settings in every.items()}
    return {name: asdict(depth_report(frame, exact)) for name, frame in frames.items()}


Change = Callable[[int], tuple[Signals, float]]
"""Signals and the camera's azimuth of frame k."""


def posing(bench: Bench) -> Change:
    """A new body pose in every frame."""
    return lambda k: (bench.signals(2 * k + 1), 20.0)


def turning(bench: Bench) -> Change:
    """The camera goes around somebody who stands."""
    return lambda k: (bench.signals(), 20.0 + 5 * k)


def dragging(bench: Bench) -> Change:
    """One arm is lifted."""
    rest = bench.signals()

    def at(k: int) -> tuple[Signals, float]:
        pose = np.array(rest.body_pose)
        pose[LEFT_SHOULDER] += [0, 0, 0.05 * k]
        return rest.replace(body_pose=pose), 20.0

    return at


def sequence(bench: Bench, settings: RenderSettings, size: int, count: int, change: Change) -> list[Frame]:
    """`count` frames after `WARM` others."""
    frames: list[Frame] = []
    for k in range(count + WARM):
        signals, azimuth = change(k)
        previous = frames[-1] if frames else None
        frames.append(render_frame(bench.placed, signals, bench.camera(size, azimuth), settings, previous))
    return frames[WARM:]


def lag(bench: Bench, frame: Frame) -> dict[str, float]:
    """How far a frame that kept what hardly moved is from the same one made anew."""
    anew = render_frame(bench.placed, frame.signals, frame.camera, replace(frame.settings, reuse_tolerance=0.0))
    both = anew.pointmap.hit & frame.pointmap.hit
    apart = 1e3 * (anew.pointmap.position - frame.pointmap.position).norm(dim=-1)[both]
    noise = (anew.image - frame.image)[both].square().mean()
    return {
        "lag_mean_mm": float(apart.mean()),
        "lag_p99_mm": float(apart.quantile(0.99)),
        "lag_psnr_db": float(-10 * noise.clamp_min(1e-10).log10()),
    }


def idle_work(bench: Bench, size: int) -> int:
    """Sum of all counters of a frame in which nothing has changed."""
    signals, camera = bench.signals(), bench.camera(size)
    frame = render_frame(bench.placed, signals, camera, level(EVERYDAY))
    return sum(render_frame(bench.placed, signals, camera, level(EVERYDAY), frame).counters.values())


def by_stage(frames: list[Frame]) -> dict[str, float]:
    """Medians, milliseconds."""
    return {f"{name}_ms": median(frame.ms[name] for frame in frames) for name in frames[0].ms if name != "total"}


def _total(frames: list[Frame]) -> float:
    return median(frame.ms["total"] for frame in frames)
