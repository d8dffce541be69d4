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
from avatarrex_studio.engine.passes import passes
from avatarrex_studio.engine.staging import in_light, over_stage
from avatarrex_studio.engine.work import summed
from avatarrex_studio.session.state import StudioState
from tqdm import tqdm

from avatarrex.files.background import background_writer
from avatarrex.files.gate import write_text
from avatarrex.files.images import write_arrays, write_png
from avatarrex.files.video import Append, video_writer
from avatarrex.stage.lighting import Lit


def run(job: Job, engine: Engine) -> list[Path]:
    """Render and write every frame; returns what was written."""
    written: list[Path] = []
    statistics: list[dict[str, object]] = []
    width, height = job.size
    video = video_writer(job.out, width, height, job.fps, job.sound) if job.kind == "video" else None
    engine.avatar(job.start.avatar)
    job = with_view(job, engine)
    if job.motion:
        for note in job.motion.sequence.notes:
            print(f"{Path(job.motion.path).name}: {note}", file=sys.stderr)
    bar = tqdm(total=len(job.frames), unit="frame", disable=len(job.frames) == 1)
    with bar, video or nullcontext() as append, background_writer() as do:
        for number, state in job.states():
            frames = engine.frames(state, state.view.camera(width, height))
            if not statistics:
                tqdm.write(", ".join(frames[0].notes), file=sys.stderr)
            arrays = passes(frames, job.aovs) if job.aovs else {}
            path = job.image_path(number)
            do(_keep, path, state, in_light(frames, state), arrays, append)
            written += [] if video else [path]
            written += [path.with_suffix(".npz")] if job.aovs else []
            statistics.append({"frame": number, **summed(frames)})
            bar.update()
    if video:
        written.append(job.out)
    if job.stats:
        write_text(job.stats, json.dumps(statistics, indent=1) + "\n")
        written.append(job.stats)
    return written


def _keep(path: Path, state: StudioState, shown: Lit, arrays: dict[str, np.ndarray], append: Append | None) -> None:
    """Encode and write one frame while the next is rendered."""
    pixels = over_stage(shown, state)
    if append:
        append(pixels)
    else:
        write_png(path, pixels, {"avatarrex": json.dumps(state.to_json())})
    if arrays:
        write_arrays(path.with_suffix(".npz"), arrays)


def with_view(job: Job, engine: Engine) -> Job:
    """The job with the view that its `framing` names; it goes along with the target of each frame."""
    if not job.framing:
        return job
    start = job.start.view
    steps = [(np.subtract(state.view.target, start.target), state) for _, state in job.states()]
    points = np.concatenate([engine.outline(state) - step for step, state in steps])
    if job.framing == "distance":
        view = backed_off(start, points, job.size)
    else:
        view = framed(start, points, job.size)
        if job.framing == "target":
            view = replace(view, distance=start.distance)
    return replace(job, start=job.start.change(view=view), framing="")
