"""The surface of a run's avatar (distil/), after the training: the last checkpoint is written once more, with it.

    RUN/distil/     what was observed so far; removed at the end

The trained avatar is on the disk before: whatever stops this leaves it as it is, and it goes on where it was stopped.
"""

from __future__ import annotations

import shutil
import time

from avatarrex.avatar_file import load_avatar
from avatarrex.distil.distil import POSES, distil
from avatarrex.distil.progress_bars import ProgressBars
from avatarrex.errors import InputError
from avatarrex.surface.surface import Surface
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.folder import Run

POLL_SECONDS = 0.2
"""Between two looks at a paused run."""


class Stopped(Exception):
    """A viewer requested a stop."""


def add_surface(run: Run, device: str = "cpu", poses: int = POSES) -> Surface:
    """The surface of the avatar of the last checkpoint of `run`: distilled and stored there unless it has one.

    Obeys pause and stop: raises `Stopped`. Raises `InputError` where there is no avatar, or the disk does not take it.
    """
    found = checkpoint.newest(run.path / "checkpoints")
    if found is None:
        raise InputError(run.path, "checkpoints", "a checkpoint with an avatar", "none")
    entry, state = found
    avatar = load_avatar(entry.path / checkpoint.AVATAR_FILE, device)
    if avatar.surface is not None:
        return avatar.surface

    def report(what: str, done: int, of: int) -> None:
        if (what, of) != (run.pass_name, run.steps):
            run.stage("surface", what, of)
        run.step = done
        while (wish := run.control()) == "pause":
            time.sleep(POLL_SECONDS)
        if wish == "stop":
            raise Stopped

    work = run.path / "distil"
    with ProgressBars(report) as bars:
        avatar.surface = distil(avatar, work, poses, bars)
    run.stage(entry.manifest.part, "surface", 0)
    run.save(entry.manifest.step, state, avatar, entry.manifest.score)
    if work.exists():
        shutil.rmtree(work)
    return avatar.surface
