"""The kinds of jobs that kill_jobs.py kills, each with a small source of its own: what takes long and goes on after a stop."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import job_results

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS)]
TIMES = 12
"""As often the three frames of a foreign capture are written: enough files to be killed among."""


@dataclass(frozen=True)
class Job:
    """A kind of job."""

    name: str
    words: Callable[[Path], tuple[str, ...]]
    """The command that works in a folder, by what is in it: the one to begin with, or to go on."""
    made: Callable[[Path], job_results.Made]
    """What it has made there."""


def jobs(folder: Path) -> list[Job]:
    """All kinds; their sources are made in `folder`."""
    from avatarrex_studio.jobs.training_process import COMMAND

    capture, film, foreign = (str(folder / name) for name in ("capture", "film", "foreign"))
    _sources(folder)

    def train(out: Path) -> tuple[str, ...]:
        more = ("--resume",) if (out / "run" / "run.json").exists() else ()
        return (*COMMAND, "train", capture, "--recipe", "smoke", "--no-surface", "--out", str(out / "run"), *more)

    def fixed(*words: str) -> Callable[[Path], tuple[str, ...]]:
        return lambda place: (*COMMAND, *(word.replace("OUT", str(place)) for word in words))

    return [
        Job("train", train, job_results.training),
        Job("import", fixed("capture", "import", foreign, "OUT/imported"), job_results.files),
        Job("make", fixed("capture", "make", "OUT/made", "--size", "smoke"), job_results.files),
        Job("prepare", fixed("capture", "prepare", film, "OUT/prepared", "--no-refine"), job_results.files),
        Job("refine", fixed("capture", "refine", capture, "OUT/refined"), job_results.files),
        Job("distil", fixed("distil", "default", "--poses", "4", "--out", "OUT/avatar"), job_results.surface),
    ]


def _sources(folder: Path) -> None:
    """A tiny capture in our layout, pictures as somebody films them, and a capture in ZJU-MoCap's; those that are there stay."""
    from capture import filmed, foreign
    from capture.clothed import Clothed
    from capture.tiny_capture import TinyCapture

    if not (folder / "capture").exists():
        TinyCapture.make(("body", "face")).folder(folder / "capture")
    if not (folder / "film").exists():
        filmed.film(Clothed(cameras=4, frames=4, size=(96, 128)), folder / "film", faces=True)
    if not (folder / "foreign").exists():
        scene = foreign.scene(1)
        count = len(scene.signals)
        images, mattes = (
            {(name, frame + count * time): one for time in range(TIMES) for (name, frame), one in kept.items()}
            for kept in (scene.images, scene.mattes)
        )
        foreign.written_zju(
            replace(scene, signals=TIMES * scene.signals, images=images, mattes=mattes), folder / "foreign"
        )
