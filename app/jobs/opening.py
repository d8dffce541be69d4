"""Anything that a user opens, read without a window: `read_any`, slow enough to be done in a thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path

from avatarrex_studio.jobs.file_kind import (
    AVATAR,
    CAPTURE,
    FOREIGN,
    MOTION,
    OPENS,
    RUN,
    SESSION,
    how_to_import,
    kind_of,
    runs_in,
)
from avatarrex_studio.jobs.run_view import RunView, keep_avatar
from avatarrex_studio.jobs.runs import Watched
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError
from avatarrex.signals.import_options import ImportOptions


@dataclass(frozen=True)
class Opened:
    """What a path contains, whole and ready to be shown."""

    kind: str
    path: str
    """As it was given; of a folder of runs the newest run."""
    avatars: dict[str, Future[Avatar]] = field(default_factory=dict)
    """The avatars to show by name, read; of a session all."""
    motion: Motion | None = None
    journal: Journal | None = None
    words: str = ""
    """What there is to say about it."""


def read_any(path: str, read_avatar: Callable[[str], Future[Avatar]]) -> Opened:
    """What is at `path`; avatars by `read_avatar`, waited for. Raises `InputError`."""
    kind = kind_of(path)
    if kind == AVATAR:
        return Opened(kind, path, {path: _whole(read_avatar(path))})
    if kind == MOTION:
        return read_motion(path)
    if kind == SESSION:
        journal = Journal.load(path)
        names = dict.fromkeys(figure.avatar for figure in journal.state.figures)
        return Opened(kind, path, {name: _whole(read_avatar(name)) for name in names}, journal=journal)
    if kind == CAPTURE:
        return Opened(kind, path, words=contents(open_capture(path)))
    if kind == RUN:
        return _run(path, read_avatar)
    raise InputError(path, "", OPENS, how_to_import(path) if kind == FOREIGN else f"a {kind}")


def read_motion(path: str, options: ImportOptions | None = None) -> Opened:
    """A motion file, guesses replaced by `options`, or a motion that comes with the program by its name. Raises `InputError`."""
    return Opened(MOTION, path, motion=Motion.read(path, options))


def contents(capture: Capture) -> str:
    """How much a capture has: `body: 24 frames, 16 cameras; face: 8 frames, 6 cameras`."""
    return "; ".join(f"{name}: {rig.frames} frames, {len(rig.views)} cameras" for name, rig in capture.rigs.items())


def newest_run(path: str | Path) -> RunView:
    """The run at `path`, or of a folder of runs the one that was started last. Raises `InputError`."""
    views = []
    for folder in runs_in(Path(path)):
        watched = Watched(folder, folder.name)
        while watched.poll():
            pass
        views.append(watched.view)
    if not views:
        raise InputError(path, "", "a run", "none by now")
    return max(views, key=lambda view: view.about.get("started") or 0)


def _run(path: str, read_avatar: Callable[[str], Future[Avatar]]) -> Opened:
    """A run with its newest avatar, under a name that stays; without one as long as there is none."""
    run = newest_run(path)
    if run.avatar is None:
        return Opened(RUN, str(run.path), words=f"{run.state}; no checkpoint with an avatar yet")
    name = str(keep_avatar(run))
    read = {name: _whole(read_avatar(name))}
    return Opened(RUN, str(run.path), read, words=f"{run.state}; avatar {Path(name).stem}")


def _whole(reading: Future[Avatar]) -> Future[Avatar]:
    """The same, once it is there. Raises what the reading raised."""
    reading.result()
    return reading
