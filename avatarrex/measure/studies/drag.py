"""A dragged arm: how rough its voxels and how late its picture may be, against what that saves.

    python -m avatarrex.measure.studies.drag --frames 14

For each voxel and tolerance (`levels.DRAGGED_VOXEL`, `levels.REUSE_TOLERANCE`): voxels and pixels made anew in a frame,
processor milliseconds (one thread, medians), how far the last frame lags behind the same frame made anew, and how far the
surface of such voxels is from the exact one (64², millimetres), at 192² as `bench frame` drags.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from statistics import median

import torch

from avatarrex.levels import level
from avatarrex.measure.bench.frame import JUDGED, WARM, dragging, lag
from avatarrex.measure.bench.session import Bench
from avatarrex.pipeline import Frame, RenderSettings, render_frame
from avatarrex.reference.error_report import depth_report
from avatarrex.reference.oracle import render_oracle

SIZE = 192
VOXELS, HOLDS = (0.02, 0.025, 0.03), (1e-3, 2e-3, 3e-3)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=14)
    frames = parser.parse_args().frames
    torch.set_num_threads(1)
    bench = Bench()
    signals, camera = bench.motion(JUDGED + 1)[-1], bench.camera(64)
    exact = render_oracle(bench.avatar, signals, camera)
    print("voxel  hold  voxels  pixels    ms   lag mean / p99, psnr     error mean / p99")
    for voxel in VOXELS:
        rough = replace(level("fast"), voxel=voxel)
        error = depth_report(render_frame(bench.avatar, signals, camera, rough), exact)
        for hold in HOLDS:
            drawn, times = dragged(bench, replace(rough, reuse_tolerance=hold), frames)
            anew = (median(frame.counters[name] for frame in drawn) for name in ("voxels_evaluated", "pixels_shaded"))
            late = lag(bench, drawn[-1])
            print(
                f"{100 * voxel:3.1f} cm {1e3 * hold:2.0f} mm", *(f"{count:7.0f}" for count in anew), f"{median(times):6.0f}",
                f"  {late['lag_mean_mm']:.2f} / {late['lag_p99_mm']:.2f} mm, {late['lag_psnr_db']:.1f} dB",
                f"  {error.depth_mean_mm:.2f} / {error.depth_p99_mm:.1f} mm",
            )  # fmt: skip


def dragged(bench: Bench, settings: RenderSettings, count: int) -> tuple[list[Frame], list[float]]:
    """Frames of the arm on its way up, after `WARM` others, and their processor milliseconds."""
    found: list[Frame] = []
    times = []
    for k in range(count + WARM):
        begun = time.process_time()
        pose = dragging(bench)(k)[0]
        found.append(render_frame(bench.avatar, pose, bench.camera(SIZE), settings, found[-1] if found else None))
        times.append(1e3 * (time.process_time() - begun))
    return found[WARM:], times[WARM:]


if __name__ == "__main__":
    main()
