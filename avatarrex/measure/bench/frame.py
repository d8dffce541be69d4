"""Stage `frame`: whole frames of every level, beside volume rendering of the same avatar and textured meshes.

Frames follow each other as in the studio: the frame before is at hand. Times are what a user waits (wall clock); ratios and
errors come from the same run. Errors of levels: against the oracle's exact frame (reference/error_report.py). Networks run on the session's
device, those of the oracle and of rivals on the CPU.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from avatarrex.frame import Frame
from avatarrex.levels import DEFERRED_LEVELS, dragged, level, moving
from avatarrex.measure.bench.live import of_the_surface
from avatarrex.measure.bench.motion import by_stage, dragging, everything, expressing, posing, sequence, total, turning
from avatarrex.measure.bench.report import FASTER, Metric
from avatarrex.measure.bench.rivals import naked_template, volume_rendering
from avatarrex.measure.bench.session import Bench
from avatarrex.pipeline import render_frame
from avatarrex.reference.error_report import depth_report
from avatarrex.reference.oracle import render_oracle

JUDGED = 5
"""Frame of the motion that errors are measured in: an arm on its way up."""
EVERYDAY, DRAGGING = "balanced", "fast"
"""Levels that the targets of a whole frame are about."""


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    large, small, drag = bench.side(512, 512), bench.side(256, 256), bench.side(192, 192)
    poses, views = bench.count(6, 2), bench.count(12, 4)
    errors = bench.once(level_errors)
    metrics, new_pose = [], {}
    for name, settings in DEFERRED_LEVELS.items():
        frames = sequence(bench, settings, large, poses, posing)
        new_pose[name] = total(frames)
        error = {**errors[name], **by_stage(frames)}
        metrics.append(Metric(f"frame.level.{name}.ms", new_pose[name], "ms", error=error))
    turned = total(sequence(bench, moving(level(EVERYDAY)), small, views, turning))
    drags = sequence(bench, dragged(level(DRAGGING)), drag, views, dragging)
    drag_errors = {**errors["dragged"], **lag(bench, drags[-1]), **by_stage(drags)}
    metrics += [
        Metric("frame.new_pose_512_ms", new_pose[EVERYDAY], "ms", error=errors[EVERYDAY], target=500.0),
        Metric("frame.view_256_fps", 1e3 / turned, "fps", "higher", errors[EVERYDAY], 15.0),
        Metric("frame.drag_fps", 1e3 / total(drags), "fps", "higher", drag_errors, 10.0),
        Metric("frame.idle_work", idle_work(bench, small), "counts", target=0),
        *of_a_person(bench),
        *of_a_gpu(bench),
        *of_the_surface(bench),
        *volume_rendering(bench, large),
        *naked_template(bench, large),
    ]
    error = {"ours": errors[EVERYDAY], "paper": errors["paper"]}
    faster = new_pose["paper"] / new_pose[EVERYDAY]
    return [*metrics, Metric("frame.vs_paper_level", faster, FASTER, "higher", error, 3.0)]


def of_a_person(bench: Bench) -> list[Metric]:
    """Body, hands, face and camera all new, at every level but `live`; an expression alone, and the view alone."""
    large, larger = bench.side(512, 512), bench.side(1024, 1024)
    poses, views = bench.count(6, 2), bench.count(12, 4)
    errors, everyday = bench.once(level_errors), level(EVERYDAY)
    found, all_new = [], {}
    for name, settings in DEFERRED_LEVELS.items():
        frames = sequence(bench, settings, large, poses, everything)
        all_new[name] = total(frames)
        error = {**errors[name], **by_stage(frames)}
        found.append(Metric(f"frame.everything_512.{name}.ms", all_new[name], "ms", error=error))
    found.append(Metric("frame.everything_512_ms", all_new[EVERYDAY], "ms", error=errors[EVERYDAY], target=250.0))
    for name, size, change, target in (
        ("everything_1024_ms", larger, everything, None),
        ("expression_512_ms", large, expressing, 120.0),
    ):
        frames = sequence(bench, everyday, size, poses, change)
        error = {**errors[EVERYDAY], **by_stage(frames)}
        found.append(Metric(f"frame.{name}", total(frames), "ms", error=error, target=target))
    turned, without = (sequence(bench, settings, large, views, turning) for settings in (moving(everyday), everyday))
    error = {**errors[EVERYDAY], **by_stage(turned), **lag(bench, turned[-1]), "without_reuse_ms": total(without)}
    return [*found, Metric("frame.view_512_fps", 1e3 / total(turned), "fps", "higher", error, 20.0)]


def of_a_gpu(bench: Bench) -> list[Metric]:
    """Frames at 1024²; targets are those of one H100: everything changes, and the view alone."""
    size, cuda = bench.side(1024, 1024), bench.device.startswith("cuda")
    error = bench.once(level_errors)[EVERYDAY]
    found, new_pose = [], ("new_pose", 120.0, bench.count(6, 2), posing)
    for name, target, count, change in (new_pose, ("view", 300.0, bench.count(12, 4), turning)):
        frames = sequence(bench, level(EVERYDAY), size, count, change)
        by = {**error, **by_stage(frames), "networks": frames[-1].device}
        fps = 1e3 / total(frames)
        found.append(Metric(f"frame.{name}_1024_fps", fps, "fps", "higher", by, target if cuda else None))
    return found


def level_errors(bench: Bench) -> dict[str, dict[str, Any]]:
    """`Accuracy` of every level against the exact frame, 64×64; `dragged`: with the voxels that a limb is dragged with."""
    signals, camera = bench.signals(JUDGED), bench.camera(bench.side(64, 64))
    exact = render_oracle(bench.avatar, signals, camera)
    every = {**DEFERRED_LEVELS, "dragged": dragged(level(DRAGGING))}
    frames = {name: render_frame(bench.placed, signals, camera, settings) for name, settings in every.items()}
    return {name: asdict(depth_report(frame, exact)) for name, frame in frames.items()}


def lag(bench: Bench, frame: Frame) -> dict[str, float]:
    """How far a frame that kept what hardly moved, or what earlier views told, is from the same one made anew."""
    settings = replace(frame.settings, reuse_tolerance=0.0, colour_tolerance=0.0)
    anew = render_frame(bench.placed, frame.signals, frame.camera, settings)
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
