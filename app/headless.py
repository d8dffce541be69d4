"""`avatarrex-studio render`: frames to PNG files, a folder of them, or a video, with passes and statistics beside them.

Everything is read and checked before anything is written, and every file appears whole or not at all.
"""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from avatarrex_studio import options
from avatarrex_studio.commands import ApplyExpression, ApplyPose, Command, SetBackground, SetCamera, apply
from avatarrex_studio.engine import Engine
from avatarrex_studio.framing import backed_off, framed
from avatarrex_studio.motion import Motion
from avatarrex_studio.state import StudioState
from tqdm import tqdm

from avatarrex.errors import InputError
from avatarrex.images import VideoWriter, composite, write_arrays, write_png, write_text
from avatarrex.pipeline import Frame

DEFAULT_SIZE = (512, 512)
_FRAMING = {(True, True): "place", (True, False): "target", (False, True): "distance", (False, False): ""}
"""What is chosen where target or distance are not given."""


@dataclass(frozen=True)
class Job:
    """A checked render order."""

    out: Path
    kind: str
    """`image`, `folder` or `video`."""
    start: StudioState
    motion: Motion | None
    frames: tuple[int, ...]
    edits: tuple[Command, ...]
    """Applied on top of each frame of the motion."""
    size: tuple[int, int]
    aovs: tuple[str, ...]
    stats: Path | None
    fps: float = 30.0
    framing: str = ""
    """What is chosen so that the person is seen in every frame: `place` (target and distance), `target`, `distance`."""

    def states(self) -> Iterator[tuple[int, StudioState]]:
        """Each frame's number and state."""
        for number in self.frames:
            state = self.start
            if self.motion:
                state = apply(state, self.motion.loaded(state.signals))
                state = apply(state, self.motion.at(number, state.signals))
            for command in self.edits:
                state = apply(state, command)
            yield number, state

    def framed(self, engine: Engine) -> Job:
        """The order with the view that `framing` asks for; it goes along with the target of each frame."""
        if not self.framing:
            return self
        start = self.start.view
        steps = [(np.subtract(state.view.target, start.target), state) for _, state in self.states()]
        points = np.concatenate([engine.outline(state) - step for step, state in steps])
        if self.framing == "distance":
            view = backed_off(start, points, self.size)
        else:
            view = framed(start, points, self.size)
            if self.framing == "target":
                view = replace(view, distance=start.distance)
        return replace(self, start=self.start.change(view=view), framing="")

    def image_path(self, number: int) -> Path:
        """Where the image of a frame goes; its passes lie beside it as `.npz`."""
        if self.kind == "folder":
            return self.out / f"frame_{number:06d}.png"
        return self.out if self.kind == "image" else self.out.with_name(f"{self.out.stem}_{number:06d}.png")


def job(arguments: Namespace) -> Job:
    """Read and check the options of `render`. Raises `InputError`."""
    out = Path(arguments.out)
    kind = _kind(arguments.out, out)
    motion = Motion.read(arguments.motion) if arguments.motion else None
    frames = _frames(arguments, motion, kind)
    state = StudioState(avatar=arguments.avatar, limit_joints=False)
    view = options.camera(arguments.camera) if arguments.camera else SetCamera()
    if view.target and view.follow is None:
        view = replace(view, follow=False)
    state = apply(state, view)
    background = options.background(arguments.background) if arguments.background else state.background
    if arguments.alpha:
        background = (0.0, 0.0, 0.0, 0.0)
    size = options.size(arguments.size) if arguments.size else DEFAULT_SIZE
    if kind == "video" and background[3] < 1:
        option = "--alpha" if arguments.alpha else "--background"
        raise InputError(option, "", "an opaque background for .mp4", "a transparent one")
    stats = Path(arguments.stats) if arguments.stats else None
    for path in filter(None, (stats, out if kind != "folder" else None)):
        if path.is_dir():
            raise InputError(path, "", "a file to write", "a folder")
    fps = 30.0
    if motion:
        step = frames[1] - frames[0] if len(frames) > 1 else 1
        fps = motion.sequence.fps / abs(step)
    edits = _edits(arguments)
    order = Job(
        out, kind, apply(state, SetBackground(background)), motion, frames, edits, size,
        options.aovs(arguments.aov) if arguments.aov else (), stats, fps,
        _FRAMING[view.target is None, view.distance is None],
    )  # fmt: skip
    next(order.states())  # an edit that cannot be applied is refused now
    return order


def run(order: Job, engine: Engine) -> list[Path]:
    """Render and write every frame; returns what was written."""
    written: list[Path] = []
    statistics: list[dict[str, object]] = []
    video = VideoWriter(order.out, *order.size, order.fps) if order.kind == "video" else None
    engine.avatar(order.start.avatar)
    order = order.framed(engine)
    with video or nullcontext():
        bar = tqdm(order.states(), total=len(order.frames), unit="frame", disable=len(order.frames) == 1)
        for number, state in bar:
            frame = engine.frame(state, state.view.camera(*order.size))
            if not statistics:
                tqdm.write(", ".join(frame.notes), file=sys.stderr)
            pixels = composite(frame.image, state.background)
            path = order.image_path(number)
            if video:
                video.write(pixels)
            else:
                write_png(path, pixels, {"avatarrex": json.dumps(state.to_json())})
                written.append(path)
            if order.aovs:
                write_arrays(path.with_suffix(".npz"), passes(frame, order.aovs))
                written.append(path.with_suffix(".npz"))
            statistics.append({"frame": number, "ms": frame.ms, "counters": frame.counters})
    if video:
        written.append(order.out)
    if order.stats:
        write_text(order.stats, json.dumps(statistics, indent=1) + "\n")
        written.append(order.stats)
    return written


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


def _kind(text: str, out: Path) -> str:
    if text.endswith("/") or out.is_dir() or not out.suffix:
        if out.exists() and not out.is_dir():
            raise InputError(out, "", "a folder, OUT.png or OUT.mp4", "a file without an extension")
        return "folder"
    kinds = {".png": "image", ".mp4": "video"}
    if out.suffix.lower() not in kinds:
        raise InputError(out, "", "OUT.png, OUT.mp4 or a folder", out.suffix)
    return kinds[out.suffix.lower()]


def _frames(arguments: Namespace, motion: Motion | None, kind: str) -> tuple[int, ...]:
    for option in ("frame", "frames"):
        if getattr(arguments, option) is not None and motion is None:
            raise InputError(f"--{option}", "", "--motion FILE with it", "no motion")
    if motion is None:
        if kind == "video":
            raise InputError(arguments.out, "", "--motion FILE for a video", "no motion")
        return (0,)
    if arguments.frame is not None:
        return (options.frame(arguments.frame, len(motion)),)
    if arguments.frames is None:
        return (0,) if kind == "image" else tuple(range(len(motion)))
    chosen = tuple(options.frames(arguments.frames, len(motion)))
    if kind == "image" and len(chosen) > 1:
        raise InputError(arguments.out, "", f"a folder or OUT.mp4 for {len(chosen)} frames", "one image")
    return chosen


def _edits(arguments: Namespace) -> tuple[Command, ...]:
    """Named poses first, single settings last."""
    commands: list[Command] = [ApplyPose(name) for name in arguments.pose]
    for text in arguments.hand:
        commands.extend(options.hand(text))
    commands.extend(ApplyExpression(name) for name in arguments.expression)
    commands.extend(options.setting(text) for text in arguments.set)
    return tuple(commands)
