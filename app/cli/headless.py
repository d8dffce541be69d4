"""`avatarrex-studio render`: frames to PNG files, a folder of them, or a video, with passes and statistics beside them.

Every file appears whole or not at all; frames that are done stay where a later one fails.
"""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
from avatarrex_studio.cli.job import Job
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.framing import backed_off, framed
from avatarrex_studio.session.state import StudioState
from torch import Tensor
from tqdm import tqdm

from avatarrex.files.background import background_writer
from avatarrex.files.gate import write_text
from avatarrex.files.images import VideoWriter, composite, write_arrays, write_png
from avatarrex.pipeline import Frame


def run(order: Job, engine: Engine) -> list[Path]:
    """Render and write every frame; returns what was written."""
    written: list[Path] = []
    statistics: list[dict[str, object]] = []
    width, height = order.size
    video = VideoWriter(order.out, width, height, order.fps) if order.kind == "video" else None
    engine.avatar(order.start.avatar)
    order = with_view(order, engine)
    if order.motion:
        for note in order.motion.sequence.notes:
            print(f"{Path(order.motion.path).name}: {note}", file=sys.stderr)
    bar = tqdm(total=len(order.frames), unit="frame", disable=len(order.frames) == 1)
    with bar, video or nullcontext(), background_writer() as do:
        for number, state in order.states():
            frame = engine.frame(state, state.view.camera(width, height))
            if not statistics:
                tqdm.write(", ".join(frame.notes), file=sys.stderr)
            arrays = passes(frame, order.aovs) if order.aovs else {}
            do(_keep, order.image_path(number), state, frame.image, arrays, video)
            path = order.image_path(number)
            written += [] if video else [path]
            written += [path.with_suffix(".npz")] if order.aovs else []
            statistics.append({"frame": number, "ms": frame.ms, "counters": frame.counters})
            bar.update()
    if video:
        written.append(order.out)
    if order.stats:
        write_text(order.stats, json.dumps(statistics, indent=1) + "\n")
        written.append(order.stats)
    return written


def _keep(
    path: Path, state: StudioState, image: Tensor, arrays: dict[str, np.ndarray], video: VideoWriter | None
) -> None:
    """Encode and write one frame while the next is rendered."""
    pixels = composite(image, state.background)
    if video:
        video.write(pixels)
    else:
        write_png(path, pixels, {"avatarrex": json.dumps(state.to_json())})
    if arrays:
        write_arrays(path.with_suffix(".npz"), arrays)


def with_view(order: Job, engine: Engine) -> Job:
    """The order with the view that its `framing` asks for; it goes along with the target of each frame."""
    if not order.framing:
        return order
    start = order.start.view
    steps = [(np.subtract(state.view.target, start.target), state) for _, state in order.states()]
    points = np.concatenate([engine.outline(state) - step for step, state in steps])
    if order.framing == "distance":
        view = backed_off(start, points, order.size)
    else:
        view = framed(start, points, order.size)
        if order.framing == "target":
            view = replace(view, distance=start.distance)
    return replace(order, start=order.start.change(view=view), framing="")


def passes(frame: Frame, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The named passes, float32, world space, metres, zero where the ray through the pixel's centre misses; and `hit`.

    depth (h, w) along the camera's axis; normal, position (h, w, 3); mask (h, w) coverage from 0 to 1.
    """
    points, world = frame.pointmap, frame.world_from_root
    hit = points.hit.cpu().numpy()
    rotation, translation = world[:3, :3], world[:3, 3]
    made = {
        "depth": lambda: points.depth.double().cpu().numpy() * hit,
        "normal": lambda: points.normal.double().cpu().numpy() @ rotation.T * hit[..., None],
        "position": lambda: (points.position.double().cpu().numpy() @ rotation.T + translation) * hit[..., None],
        "mask": lambda: points.coverage.cpu().numpy(),
    }
    return {**{name: made[name]().astype(np.float32) for name in names}, "hit": hit}
