"""Runs below a folder, read a little at a time as they grow, each published as a frozen `RunView`; no file ends the reading."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from avatarrex_studio.jobs.run_view import RunView, checkpoints_of, newest_avatar

from avatarrex.errors import plain
from avatarrex.files.gate import what_is
from avatarrex.training.runs.control import Heartbeat, read_json
from avatarrex.training.runs.events import EventReader

log = logging.getLogger(__name__)
DEPTH = 3
"""Folders below the one that is watched in which runs are looked for."""
SLOW_SECONDS = 2.0
"""Between two listings of folders."""
JSON: Any = dict | list | str | int | float | None
"""Any kind of value that JSON knows."""
KINDS: dict[str, Any] = {
    "config": dict, "state": str, "started": int | float, "resumed": list,
    **dict.fromkeys(("part", "preset", "capture", "note"), str | None),
}  # fmt: skip
"""Kinds of value in run.json."""
ENDED = ("finished", "stopped", "failed")


class Watched:
    """One run folder, read a little at a time."""

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.name = path, name
        self.reader = EventReader(path)
        self.view = RunView(path, name, "dead")
        self._listed = -1e9
        self._listing: dict[str, Any] = {}
        """Fields of the view that come from listing folders, which is done less often."""

    def poll(self) -> bool:
        """Read on; True where more is waiting."""
        waiting = self.reader.poll()
        if time.monotonic() - self._listed > SLOW_SECONDS:
            self._listed = time.monotonic()
            checkpoints = checkpoints_of(self.path)
            # A listed checkpoint may be gone, and the next one not be listed: no button flickers for that.
            avatar = newest_avatar(checkpoints) or self._listing.get("avatar")
            self._listing = {"samples": _samples(self.path), "checkpoints": checkpoints, "avatar": avatar}
        self.view = self._look()
        return waiting

    def _look(self) -> RunView:
        about, beat = _about(read_json(self.path / "run.json")), Heartbeat.read(self.path)
        series = {tag: self.reader.series(tag) for tag in self.reader.tags}
        if "config" not in about:
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
            **self._listing,
        )  # fmt: skip


class Runs:
    """All runs below a folder."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.others: tuple[Path, ...] = ()
        """Single runs elsewhere."""
        self._watched: dict[Path, Watched] = {}
        self._listed = -1e9

    def poll(self) -> bool:
        """Look for runs and read on in each; True where more is waiting."""
        if time.monotonic() - self._listed > SLOW_SECONDS or not self._watched.keys() >= {*self.others}:
            self._listed = time.monotonic()
            paths = [*sorted(run_folders(self.folder)), *self.others]
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
        alone = path == self.folder or path in self.others
        return plain(path.absolute().name if alone else path.relative_to(self.folder).as_posix())


def run_folders(folder: Path, depth: int = DEPTH) -> Iterator[Path]:
    """`folder` itself where it is a run, else the runs below it."""
    if what_is(folder / "run.json") == "a file":
        yield folder
        return
    try:
        inner = [entry.path for entry in os.scandir(folder) if entry.is_dir() and not entry.name.startswith(".")]
    except OSError:
        return
    if depth:
        for path in inner:
            yield from run_folders(Path(path), depth - 1)


def _planned(steps: object, part: str) -> int:
    if isinstance(steps, dict):
        steps = steps.get(part)
    return steps if type(steps) is int and 0 <= steps < 2**31 else 0


def _about(data: dict[str, Any] | None) -> dict[str, Any]:
    """What run.json says where it is of the right kind, its texts without control characters."""
    return {name: _plain(value) for name, value in (data or {}).items() if isinstance(value, KINDS.get(name, JSON))}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {plain(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return plain(value) if isinstance(value, str) else value


def _samples(path: Path) -> dict[str, dict[str, tuple[int, ...]]]:
    found: dict[str, dict[str, tuple[int, ...]]] = {}
    top = path / "samples"
    for folder, _, names in os.walk(top):
        digits = [name[5:-4] for name in names if name.startswith("step_") and name.endswith(".png")]
        steps = tuple(sorted(int(text) for text in digits if text.isdecimal()))
        if steps:
            place = Path(folder).relative_to(top)
            found.setdefault(place.parent.as_posix(), {})[place.name] = steps
    return dict(sorted(found.items()))
