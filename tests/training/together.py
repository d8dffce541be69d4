"""One process of a small training that torchrun starts: `together.py CAPTURE RUN [DIES_AT]`; the second one kills itself once."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import tiny_recipe

import avatarrex.training.core.held_out as held_out
import avatarrex.training.core.trainer as train_module
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.training.core.process_group import ALONE, ProcessGroup, process_group, restarted
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.core.work import Work
from avatarrex.training.runs.folder import Run
from avatarrex.training.runs.follower import Follower


def _recipe(part):
    """Two frames, an odd number of rays: shares are uneven."""
    one, two = getattr(tiny_recipe.TINY, part)
    return replace(one, steps=4, rays=41, outline=33), replace(two, steps=3)


RECIPE = replace(tiny_recipe.TINY, **{part: _recipe(part) for part in ("face", "body")}, evaluate=100)


def train(capture: Path, folder: Path, group: ProcessGroup = ALONE) -> None:
    """To the end, every step reported."""
    train_module.REPORT, held_out.PICTURES = 1, 1
    config = {"part": "face,body", "preset": "tiny", "capture": str(capture), "seed": 0, "steps": RECIPE.steps()}
    run: Run | None = None
    if group.leads:
        run = Run.open(folder) if restarted() else Run.create(folder, config)
    group.wait()
    with run or Follower(folder) as followed:
        assert Trainer(open_capture(capture), RECIPE, followed, group=group).train()


def dying(at: int) -> None:
    """This process is killed before its gradients of the body's step `at` are added."""
    real = Work.descend

    def descend(self, total):
        if self.stage.part == "body" and self.step == at:
            os.kill(os.getpid(), signal.SIGKILL)
        real(self, total)

    Work.descend = descend


if __name__ == "__main__":
    with process_group("cpu") as (others, _):
        if len(sys.argv) > 3 and others.rank == 1 and not restarted():
            dying(int(sys.argv[3]))
        train(Path(sys.argv[1]), Path(sys.argv[2]), others)
