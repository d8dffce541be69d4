"""Runs below a folder, as far as they have been read: what a table, a plot or a button needs to know. No window library.

`Watcher` reads in a thread of its own and publishes frozen `RunView`s, so that whoever draws never waits for a file;
nothing that is in a file ends it. Steps count from 0 in each part; times are seconds.
"""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatarrex.errors import InputError
from avatarrex.training.control import Heartbeat, read_json
from avatarrex.training.events import EventReader, Series

log = logging.getLogger(__name__)
DEPTH = 3
"""Folders below the one that is watched in which runs are looked for."""
SECONDS = 0.5
"""Between two looks."""
SLOW_SECONDS = 2.0
"""Between two listings of folders."""
RECENT = 40
"""Last reports from which the rate is estimated."""
PICTURES = 48
"""Decoded pictures that are kept."""
ENDED = ("finished", "stopped", "failed")


@dataclass(frozen=True)
class RunView:
    """One run at one moment."""

    path: Path
    name: str
    """Its path below the watched folder."""
    state: str
    """`running`, `paused`, `finished`, `stopped`, `failed`, or `dead`: at work by its own word, without a heartbeat."""
    note: str = ""
    """Why it failed, or what could not be read."""
    about: dict[str, Any] = field(default_factory=dict)
    part: str = ""
    pass_name: str = ""
    step: int = 0
    steps: int = 0
    """Where the part ends; 0 where nobody knows."""
    series: dict[str, Series] = field(default_factory=dict)
    """By tag."""
    samples: dict[str, dict[str, tuple[int, ...]]] = field(default_factory=dict)
    """Steps by view (`body/walk_12`) and kind (`render`, `truth`)."""
    checkpoints: tuple[Path, ...] = ()
    """Oldest first."""

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """Parts of which there are numbers."""
        return tuple(sorted({tag.split("/")[0] for tag in self.series if tag.count("/") >= 2}))

    @property
    def live(self) -> bool:
        """Whether a process works on it."""
        return self.state in ("running", "paused")

    def tags(self, group: str, part: str | None = None) -> dict[str, Series]:
        """`PART/GROUP/NAME` by name, for the part at work unless given."""
        prefix = f"{self.part if part is None else part}/{group}/"
        return {tag.removeprefix(prefix): series for tag, series in self.series.items() if tag.startswith(prefix)}

    def last(self, tag: str) -> float | None:
        """The last value of `PART/tag` of the part at work."""
        series = self.series.get(f"{self.part}/{tag}")
        return float(series.values[-1]) if series is not None and len(series.values) else None

    @cached_property
    def rate(self) -> float | None:
        """Steps a second: as reported, else the median over the last reports (a pause does not count)."""
        reported = self.last("rate/steps_per_s")
        if reported is not None and reported > 0:
            return reported
        for series in self.tags("loss").values():
            steps, seconds = np.diff(series.steps[-RECENT:]), np.diff(series.times[-RECENT:])
            if (seconds > 0).any():
                return float(np.median(steps[seconds > 0] / seconds[seconds > 0]))
        return None

    @property
    def eta(self) -> float | None:
        """Seconds until the part ends, where its end and rate are known and it is at work."""
        if not (self.live and self.steps and self.rate):
            return None
        return max(self.steps - self.step, 0) / self.rate

    @property
    def progress(self) -> float | None:
        """Share of the part's steps that are done."""
        if self.state == "finished":
            return 1.0
        return min(self.step / self.steps, 1.0) if self.steps else None

    def picture(self, view: str, kind: str, step: int) -> Path | None:
        """The file of a sample: the last of its kind at or before `step`, else the first (a truth is kept once)."""
        steps = self.samples.get(view, {}).get(kind, ())
        if not steps:
            return None
        chosen = max((entry for entry in steps if entry <= step), default=steps[0])
        return self.path / "samples" / view / kind / f"step_{chosen:08d}.png"

    @property
    def avatar(self) -> Path | None:
        """The avatar beside the newest checkpoint that has one."""
        return next((path / "avatar.avatar" for path in reversed(self.checkpoints) if (path / "avatar.avatar").is_file()),
                    None)  # fmt: skip


class Watched:
    """One run folder, read a little at a time."""

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.name = path, name
        self.reader = EventReader(path)
        self.view = RunView(path, name, "dead")
        self._listed = -1e9
        self._samples: dict[str, dict[str, tuple[int, ...]]] = {}
        self._checkpoints: tuple[Path, ...] = ()

    def poll(self) -> bool:
        """Read on; True where more is waiting."""
        waiting = self.reader.poll()
        if time.monotonic() - self._listed > SLOW_SECONDS:
            self._listed = time.monotonic()
            self._samples, self._checkpoints = _samples(self.path), _checkpoints(self.path)
        self.view = self._look()
        return waiting

    def _look(self) -> RunView:
        about, beat = read_json(self.path / "run.json"), Heartbeat.read(self.path)
        series = {tag: self.reader.series(tag) for tag in self.reader.tags}
        if about is None or not isinstance(about.get("config"), dict):
            return RunView(self.path, self.name, "dead", "run.json cannot be read", series=series)
        state, note = str(about.get("state")), str(about.get("note") or "")
        if state not in ENDED and not (beat and beat.alive()):
            state = "dead"
        note = note or "; ".join(f"{name}: {text}" for name, text in self.reader.notes.items())
        newest = max(series.items(), key=lambda item: item[1].times.max(), default=None)
        reported = newest[0].split("/")[0] if newest else str(about.get("part") or "")
        part, step = beat.part if beat and beat.part else reported, beat.step if beat else 0
        if newest and part == reported:
            step = int(newest[1].steps[newest[1].times.argmax()])
        steps = beat.steps if beat and beat.steps else _planned(about["config"].get("steps"), part)
        return RunView(
            self.path, self.name, state, note, about, part, beat.pass_name if beat else "", step, steps, series,
            self._samples, self._checkpoints,
        )  # fmt: skip


class Runs:
    """All runs below a folder."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._watched: dict[Path, Watched] = {}
        self._listed = -1e9

    def poll(self) -> bool:
        """Look for runs and read on in each; True where more is waiting."""
        if time.monotonic() - self._listed > SLOW_SECONDS:
            self._listed = time.monotonic()
            paths = sorted(run_folders(self.folder))
            self._watched = {path: self._watched.get(path) or Watched(path, self._name(path)) for path in paths}
        waiting = False
        for entry in self._watched.values():
            try:
                waiting |= entry.poll()
            except Exception as error:  # a fault of ours over a strange file must not hide the other runs
                if not entry.view.note:
                    log.exception("%s cannot be read", entry.path)
                entry.view = RunView(entry.path, entry.name, "dead", f"{type(error).__name__}: {error}")
        return waiting

    @property
    def views(self) -> tuple[RunView, ...]:
        """By name."""
        return tuple(entry.view for entry in self._watched.values())

    def _name(self, path: Path) -> str:
        return path.absolute().name if path == self.folder else path.relative_to(self.folder).as_posix()


class Watcher(threading.Thread):
    """Reads the runs below a folder, and pictures that are asked for, until closed."""

    def __init__(self, folder: str | Path) -> None:
        super().__init__(name="watcher", daemon=True)
        self.folder = Path(folder)
        self.views: tuple[RunView, ...] = ()
        """The runs as they were last read; replaced, never changed."""
        self._wake, self._closed = threading.Event(), False
        self._pictures: OrderedDict[tuple[Path, int], UInt8[np.ndarray, "h w 3"] | None] = OrderedDict()
        self._asked: list[tuple[Path, int]] = []

    def run(self) -> None:
        """Read until closed."""
        runs = Runs(self.folder)
        while not self._closed:
            if runs.folder != self.folder:
                runs = Runs(self.folder)
            waiting = runs.poll()
            self.views = runs.views
            while self._asked and not self._closed:
                key = self._asked.pop()
                self._pictures[key] = _decoded(key[0])
                while len(self._pictures) > PICTURES:
                    self._pictures.popitem(last=False)
            if not waiting:
                self._wake.wait(SECONDS)
            self._wake.clear()

    def picture(self, path: Path) -> UInt8[np.ndarray, "h w 3"] | None:
        """The picture in a file once it is decoded, sRGB bytes; None until then, and for a broken one."""
        try:
            key = (path, path.stat().st_mtime_ns)
        except OSError:
            return None
        found = self._pictures.get(key, key)
        if not isinstance(found, tuple):
            return found
        if key not in self._asked:
            self._asked.append(key)
            self._wake.set()
        return None

    def look_again(self) -> None:
        """Look now, for a button was pressed."""
        self._wake.set()

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._wake.set()
        if self.is_alive():
            self.join(5)


def run_folders(folder: Path, depth: int = DEPTH) -> Iterator[Path]:
    """`folder` itself where it is a run, else the runs below it."""
    if (folder / "run.json").is_file():
        yield folder
        return
    try:
        inner = [entry.path for entry in os.scandir(folder) if entry.is_dir() and not entry.name.startswith(".")]
    except OSError:
        return
    if depth:
        for path in inner:
            yield from run_folders(Path(path), depth - 1)


def keep_avatar(run: RunView) -> Path:
    """The newest avatar of a run under a name that stays, `avatars/step_%08d.avatar`. Raises `InputError`.

    Checkpoints are removed as training goes on, and a session that shows one would lose it.
    """
    source = run.avatar
    if source is None:
        raise InputError(run.path, "", "a checkpoint with an avatar", "none yet")
    kept = run.path / "avatars" / f"{source.parent.name}.avatar"
    try:
        kept.parent.mkdir(exist_ok=True)
        if not (kept.exists() and kept.samefile(source)):
            kept.unlink(missing_ok=True)
            try:
                os.link(source, kept)
            except OSError:  # a file system without links
                shutil.copyfile(source, kept)
    except OSError as error:
        raise InputError(kept, "", "the avatar of the newest checkpoint", error.strerror or error) from None
    return kept


def _planned(steps: object, part: str) -> int:
    if isinstance(steps, dict):
        steps = steps.get(part)
    return steps if isinstance(steps, int) and not isinstance(steps, bool) else 0


def _samples(path: Path) -> dict[str, dict[str, tuple[int, ...]]]:
    found: dict[str, dict[str, tuple[int, ...]]] = {}
    top = path / "samples"
    for folder, _, names in os.walk(top):
        digits = [name[5:-4] for name in names if name.startswith("step_") and name.endswith(".png")]
        steps = tuple(sorted(int(text) for text in digits if text.isdigit()))
        if steps:
            place = Path(folder).relative_to(top)
            found.setdefault(place.parent.as_posix(), {})[place.name] = steps
    return dict(sorted(found.items()))


def _checkpoints(path: Path) -> tuple[Path, ...]:
    entries = []
    for entry in (path / "checkpoints").glob("step_*"):
        saved = (read_json(entry / "manifest.json") or {}).get("saved")
        if isinstance(saved, int):
            entries.append((saved, entry))
    return tuple(entry for _, entry in sorted(entries))


def _decoded(path: Path) -> UInt8[np.ndarray, "h w 3"] | None:
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:  # what Pillow raises for a broken file
        log.warning("%s: %s", path, error)
        return None
