"""A run at one moment: what a table, a plot or a button needs to know of it. No window library.

Steps count from 0 in each part; times are seconds.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.training.runs.control import read_json
from avatarrex.training.runs.events import Series

RECENT = 40
"""Last reports from which the rate is estimated."""


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
    avatar: Path | None = None
    """Beside the newest checkpoint that had one, when folders were listed last."""

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


def duration(seconds: float | None) -> str:
    """`42 s`, `12 min`, `3 h 05 min`, `4 d 07 h`."""
    if seconds is None:
        return "–"
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02} min" if hours < 48 else f"{hours // 24} d {hours % 24:02} h"


def checkpoints_of(path: Path) -> tuple[Path, ...]:
    """Folders of the checkpoints of the run at `path`, oldest first."""
    entries = []
    for entry in (path / "checkpoints").glob("step_*"):
        saved = (read_json(entry / "manifest.json") or {}).get("saved")
        if isinstance(saved, int):
            entries.append((saved, entry))
    return tuple(entry for _, entry in sorted(entries))


def newest_avatar(checkpoints: Sequence[Path]) -> Path | None:
    """The avatar beside the last of these that has one."""
    avatars = (path / "avatar.avatar" for path in reversed(checkpoints))
    return next((avatar for avatar in avatars if avatar.is_file()), None)


def keep_avatar(run: RunView) -> Path:
    """The newest avatar of a run under a name that stays, `avatars/step_%08d.avatar`. Raises `InputError`.

    Checkpoints are removed as training goes on, and a session that shows one would lose it.
    """
    source = newest_avatar(checkpoints_of(run.path))  # what was listed last may be gone
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
