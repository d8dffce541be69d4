"""A render order: what `avatarrex-studio render` was asked for, read and checked before anything is loaded or written.

Nothing here needs torch: a wrong option or file is refused within a second.
"""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from avatarrex_studio.cli import options
from avatarrex_studio.session.commands import ApplyExpression, ApplyPose, Command, SetBackground, SetCamera
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, what_is
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import POSES, named_pose
from avatarrex.signals.read import read_motion

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
    detail: Signals | None = None
    """The pose that feature patches are decoded from, where it is not the frame's own."""
    framing: str = ""
    """What is chosen so that the person is seen in every frame: `place` (target and distance), `target`, `distance`."""

    def states(self) -> Iterator[tuple[int, StudioState]]:
        """Each frame's number and state."""
        for number in self.frames:
            state = self.start
            if self.motion:
                state = self.motion.loaded(state.signals).apply(state)
                state = self.motion.at(number, state.signals).apply(state)
            for command in self.edits:
                state = command.apply(state)
            yield number, state

    def image_path(self, number: int) -> Path:
        """Where the image of a frame goes; its passes lie beside it as `.npz`."""
        if self.kind == "folder":
            return self.out / f"frame_{number:06d}.png"
        return self.out if self.kind == "image" else self.out.with_name(f"{self.out.stem}_{number:06d}.png")


def read_job(arguments: Namespace) -> Job:
    """Read and check the options of `render`. Raises `InputError`."""
    _given(arguments)
    out = Path(arguments.out)
    kind = _kind(arguments.out, out)
    edits, view = _edits(arguments), _view(arguments)
    background = _background(arguments, kind)
    size = options.size(arguments.size) if arguments.size else DEFAULT_SIZE
    aovs = options.aovs(arguments.aov) if arguments.aov else ()
    motion = Motion.read(arguments.motion) if arguments.motion else None
    frames = _frames(arguments, motion, kind)
    stats = _stats(arguments)
    check_writable(out / "frame_000000.png" if kind == "folder" else out)
    level = options.level(arguments.level)
    state = StudioState(avatar=arguments.avatar, limit_joints=False, level=level)
    state = SetBackground(background).apply(view.apply(state))
    fps = 30.0
    if motion:
        step = frames[1] - frames[0] if len(frames) > 1 else 1
        fps = motion.sequence.fps / abs(step)
    order = Job(
        out, kind, state, motion, frames, edits, size, aovs, stats, fps, _detail(arguments),
        _FRAMING[view.target is None, view.distance is None],
    )  # fmt: skip
    next(order.states())  # an edit that cannot be applied is refused now
    return order


def _given(arguments: Namespace) -> None:
    """Refuse empty values: a shell variable that was never set must not stand for the default."""
    for name, value in vars(arguments).items():
        if value == "":
            option = "OUT" if name == "out" else f"--{name}"
            raise InputError(option, "", "a value", "nothing")
    found = what_is(arguments.avatar)
    if arguments.avatar != "default" and found not in ("a file", "a folder"):
        raise InputError(arguments.avatar, "", "an avatar folder or an .avatar file", found)


def _view(arguments: Namespace) -> SetCamera:
    view = options.camera(arguments.camera) if arguments.camera else SetCamera()
    return replace(view, follow=False) if view.target and view.follow is None else view


def _background(arguments: Namespace, kind: str) -> options.Colour:
    colour = options.background(arguments.background) if arguments.background else StudioState().background
    if arguments.alpha:
        colour = (0.0, 0.0, 0.0, 0.0)
    if kind == "video" and colour[3] < 1:
        option = "--alpha" if arguments.alpha else "--background"
        raise InputError(option, "", "an opaque background for .mp4", "a transparent one")
    return colour


def _stats(arguments: Namespace) -> Path | None:
    if not arguments.stats:
        return None
    path = Path(arguments.stats)
    if path.suffix.lower() != ".json":
        raise InputError("--stats", "", "FILE.json", arguments.stats)
    if arguments.motion and os.path.realpath(path) == os.path.realpath(arguments.motion):
        raise InputError("--stats", "", "another file than the motion", arguments.stats)
    check_writable(path)
    return path


def _kind(text: str, out: Path) -> str:
    found = what_is(out)
    if text.endswith("/") or found == "a folder" or not out.suffix:
        if found not in ("a folder", "nothing there"):
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


def _detail(arguments: Namespace) -> Signals | None:
    """A named pose, or a motion file with `:FRAME` (0 unless given)."""
    text = arguments.detail_from
    if text is None:
        return None
    if text in POSES:
        return Signals.rest().replace(body_pose=named_pose(text))
    path, _, number = text.rpartition(":") if not os.path.exists(text) else (text, "", "0")
    if not path or not os.path.exists(path):
        raise InputError("--detail-from", "", "a named pose, or a motion file with :FRAME", text)
    sequence = read_motion(path)
    return sequence[options.frame(number, len(sequence), "--detail-from")]


def _edits(arguments: Namespace) -> tuple[Command, ...]:
    """Named poses first, single settings last."""
    commands: list[Command] = [ApplyPose(name) for name in arguments.pose]
    for text in arguments.hand:
        commands.extend(options.hand(text))
    commands.extend(ApplyExpression(name) for name in arguments.expression)
    commands.extend(options.setting(text) for text in arguments.set)
    return tuple(commands)
