"""One process of a small training that torchrun starts: `together.py CAPTURE FOLDER`.

The first trains alone in FOLDER/one; then all train in FOLDER/two, where the second kills itself once, two steps after a checkpoint.
"""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import tiny_recipe
from avatarrex_studio.cli.train import OPENED

import avatarrex.training.core.held_out as held_out
import avatarrex.training.core.trainer as train_module
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.training.core.process_group import ALONE, ProcessGroup, process_group
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.core.work import Work
from avatarrex.training.runs.folder import Run
from avatarrex.training.runs.follower import Follower

SAVED, DIES = 3, 5
"""Steps of the only checkpoint within pass I, and of the death."""
_ONE, _TWO = tiny_recipe.TINY.body
RECIPE = replace(
    tiny_recipe.TINY,
    body=(replace(_ONE, steps=6, rays=41, outline=33), replace(_TWO, steps=2)),
    interval=SAVED,
    evaluate=100,
)
"""An odd number of rays: shares are uneven."""


def train(capture: Path, folder: Path, group: ProcessGroup = ALONE) -> None:
    """To the end, every step reported."""
    train_module.REPORT, held_out.PICTURES = 1, 1
    config = {"part": "body", "preset": "tiny", "capture": str(capture), "seed": 0, "steps": RECIPE.steps()}
    run: Run | None = None
    if group.leads:
        run = Run.open(folder) if group.noted(OPENED) else Run.create(folder, config)
        group.note(OPENED, "yes")
    group.wait()
    with run or Follower(folder) as followed:
        assert Trainer(open_capture(capture), RECIPE, followed, group=group).train()


def dying() -> None:
    """This process is killed before its gradients of step `DIES` are added."""
    real = Work.descend

    def descend(self, total):
        if self.step == DIES:
            os.kill(os.getpid(), signal.SIGKILL)
        real(self, total)

    Work.descend = descend


if __name__ == "__main__":
    with process_group("cpu") as (others, _):
        if not others.noted(OPENED):
            if others.leads:
                train(Path(sys.argv[1]), Path(sys.argv[2]) / "one")
            else:
                dying()
        train(Path(sys.argv[1]), Path(sys.argv[2]) / "two", others)
