"""A dragged arm: how rough its voxels and how late its picture may be, against what that saves.

For each voxel and tolerance (`levels.DRAGGED_VOXEL`, `levels.REUSE_TOLERANCE`): voxels and pixels made anew in a frame,
processor milliseconds (one thread, medians), how far the last frame lags behind the same frame made anew (mm, dB), and how
far the surface of such voxels is from the exact one (64², mm), at 192² as `bench frame` drags.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from statistics import median

import torch

from avatarrex.levels import level
from avatarrex.measure.bench import frame as frames
from avatarrex.measure.bench import motion
from avatarrex.measure.bench.contest import spent
from avatarrex.measure.bench.session import Bench
from avatarrex.metrics.table import printed
from avatarrex.pipeline import render_frame
from avatarrex.reference.error_report import depth_report
from avatarrex.reference.oracle import render_oracle

DRAG_PIXELS = 192
VOXELS, TOLERANCES = (0.02, 0.025, 0.03), (1e-3, 2e-3, 3e-3)


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many frames."""
    parser.add_argument("--frames", type=int, default=14)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    bench = Bench()
    signals, camera = bench.signals(frames.JUDGED), bench.camera(64)
    exact = render_oracle(bench.avatar, signals, camera)
    row = printed(
        "voxel", "tolerance", "voxels", "pixels", "ms", "lag mean", "lag p99", "psnr", "error mean", "error p99"
    )
    for voxel in VOXELS:
        rough = replace(level("fast"), voxel=voxel)
        error = depth_report(render_frame(bench.avatar, signals, camera, rough), exact)
        for tolerance in TOLERANCES:
            settings = replace(rough, reuse_tolerance=tolerance)
            with spent(motion, "render_frame") as times:
                drawn = motion.sequence(bench, settings, DRAG_PIXELS, options.frames, motion.dragging)
            anew = (median(frame.counters[name] for frame in drawn) for name in ("voxels_evaluated", "pixels_shaded"))
            late = frames.lag(bench, drawn[-1])
            row(
                f"{100 * voxel:3.1f} cm", f"{1e3 * tolerance:.0f} mm", *(f"{count:.0f}" for count in anew),
                f"{median(times.cpu[motion.WARM :]):.0f}", f"{late['lag_mean_mm']:.2f}", f"{late['lag_p99_mm']:.2f}",
                f"{late['lag_psnr_db']:.1f}", f"{error.depth_mean_mm:.2f}", f"{error.depth_p99_mm:.1f}",
            )  # fmt: skip
