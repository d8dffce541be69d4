"""Run time of a frame by stage: new pose, new expression, new view.

    python benchmarks/frame.py [--avatar default] [--repeats 5]

Medians in milliseconds; the first, cold frame of each size is left out.
"""

from __future__ import annotations

import argparse
import platform
from statistics import median

import torch

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.pipeline import Frame, RenderSettings, render_frame
from avatarrex.signals.library import named_expression, named_pose
from avatarrex.signals.signals import Signals

STAGES = ("templates", "volume", "pointmap", "shading", "total")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    avatar = load_avatar(options.avatar)
    rest = Signals.rest().replace(body_pose=named_pose("stand"))
    print(f"{platform.machine()}, {torch.get_num_threads()} threads, torch {torch.__version__}")
    print(f"{'size':>5} {'change':<11}" + "".join(f"{stage:>11}" for stage in STAGES))
    for size in (256, 512):
        times: dict[str, list[Frame]] = {"pose": [], "expression": [], "view": []}
        frame = render_frame(avatar, rest, _camera(0, size), RenderSettings())
        for k in range(options.repeats):
            posed = frame.signals.replace(body_pose=named_pose("wave") * (k + 1) / options.repeats)
            frame = render_frame(avatar, posed, _camera(0, size), RenderSettings(), frame)
            times["pose"].append(frame)
            smiling = posed.replace(expression=named_expression("laugh") * (k + 1) / options.repeats)
            frame = render_frame(avatar, smiling, _camera(0, size), RenderSettings(), frame)
            times["expression"].append(frame)
            frame = render_frame(avatar, smiling, _camera(10 * k + 5, size), RenderSettings(), frame)
            times["view"].append(frame)
        for change, frames in times.items():
            row = [median(f.ms[stage] for f in frames) for stage in STAGES]
            print(f"{size:>5} {change:<11}" + "".join(f"{value:>11.1f}" for value in row))
    print(frame.notes[0])


def _camera(azimuth: float, size: int) -> Camera:
    return Camera.orbit(azimuth, 5, 2.6, 40, (0, -0.05, 0), size, size)


if __name__ == "__main__":
    main()
