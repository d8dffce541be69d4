"""`avatarrex-studio runs [FOLDER]`: trainings watched in a window, or as a table of text, one line each. Needs no torch."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from avatarrex_studio.cli import options, submit
from avatarrex_studio.cli.open import no_display
from avatarrex_studio.jobs.job_queue import dead, jobs_below, view_of
from avatarrex_studio.jobs.run_view import RunView, duration
from avatarrex_studio.jobs.runs import Runs
from avatarrex_studio.jobs.submitted import Job

from avatarrex.errors import InputError, plain

SECONDS = 1.0
"""Between two drawings of a live table."""
HEADS = ("RUN", "STATE", "PART", "PASS", "STEP", "STEPS/S", "PSNR", "SSIM", "ETA", "LOSSES")
RIGHT = ("STEP", "STEPS/S", "PSNR", "SSIM", "ETA")
COLOURS = {"running": 32, "paused": 33, "finished": 36, "failed": 31, "dead": 31}
"""ANSI colours of the states."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """What is watched, and how."""
    verb.add_argument("folder", nargs="?", default="runs", help="a run, or a folder of runs (runs)")
    verb.add_argument("--text", action="store_true", help="a live table in the terminal; needs no display")
    verb.add_argument("--once", action="store_true", help="print the table once and end")
    again = "submit the jobs below the folder again that died or failed: local or slurm"
    verb.add_argument("--requeue", metavar="WHERE", help=again)


def run(arguments: argparse.Namespace) -> int:
    """Watch until the window is closed or Ctrl+C, or print the table once. Raises `InputError`."""
    if arguments.requeue:
        return requeue(Path(arguments.folder), options.one_of("--requeue", arguments.requeue, submit.WHERE))
    if arguments.text or arguments.once:
        return show(arguments.folder, arguments.once)
    if no_display(f"runs {arguments.folder} --text"):
        return 2
    from avatarrex_studio.window.runs_window import run_window

    return run_window(arguments.folder)


def show(folder: str | Path, once: bool = False) -> int:
    """Print the runs below `folder`, once or until Ctrl+C. Raises `InputError` where there is no such folder."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "", "a folder of runs", "nothing there" if not folder.exists() else "a file")
    runs, terminal = Runs(folder), sys.stdout.isatty()
    while True:
        while runs.poll():
            pass
        width = shutil.get_terminal_size((140, 40)).columns
        views = [*runs.views, *job_views(folder, runs.views)]
        lines = table(views, width if terminal else None, colour=terminal)
        if not views:
            lines = [f"no runs below {folder}"]
        if terminal and not once:
            print("\x1b[H\x1b[2J", end="")
        print("\n".join(lines), flush=True)
        if once:
            return 0
        time.sleep(SECONDS if terminal else 10 * SECONDS)


def job_views(folder: Path, runs: Sequence[RunView]) -> list[RunView]:
    """Rows of the jobs that were submitted; of a training that its run's row tells all of, none."""
    known = {run.path.absolute(): run.state for run in runs}
    found = []
    for path in jobs_below(folder):
        job = Job.read(path)
        if job is None:
            continue
        view = view_of(job, plain(os.path.relpath(path, folder)))
        if job.run is None or known.get(job.run) != view.state:
            found.append(view)
    return found


def requeue(folder: Path, where: str) -> int:
    """Submit again what has died or failed; a training goes on from its last checkpoint. Raises `InputError`."""
    jobs = [job for job in map(Job.read, jobs_below(folder)) if job is not None]
    some = [job for job in jobs if job.state in ("failed", "stopped") or dead(job)]
    submit.again(some, where)
    for job in some:
        print(f"{job.path.name}: submitted; {job.log}")
    if not some:
        print(f"no jobs below {folder} that died or failed")
    return 0


def table(views: Sequence[RunView], width: int | None = None, colour: bool = False) -> list[str]:
    """Head and one line per run, cut to `width` columns."""
    rows = [HEADS, *map(row, views)]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = []
    for words in rows:
        columns = zip(HEADS, words, widths)
        cells = [word.rjust(room) if head in RIGHT else word.ljust(room) for head, word, room in columns]
        lines.append("  ".join(cells)[:width].rstrip())
    for number, view in enumerate(views, 1):
        if colour and view.state in COLOURS:
            painted = f" \x1b[{COLOURS[view.state]}m{view.state}\x1b[0m "
            lines[number] = lines[number].replace(f" {view.state} ", painted, 1)
    return lines


def row(view: RunView) -> tuple[str, ...]:
    """The words of one run, in the order of `HEADS`; a dash for what is not known."""
    psnr, ssim = view.last("heldout/psnr"), view.last("heldout/ssim")
    losses = {name: series.values[-1] for name, series in view.tags("loss").items()}
    terms = sorted(losses, key=lambda name: (name != "total", name))
    return (
        view.name,
        view.state,
        view.part or "–",
        view.pass_name or "–",
        f"{view.step}/{view.steps}" if view.steps else str(view.step),
        "–" if view.rate is None else f"{view.rate:.3g}",
        "–" if psnr is None else f"{psnr:.2f}",
        "–" if ssim is None else f"{ssim:.4f}",
        duration(view.eta),
        view.note or "  ".join(f"{name} {losses[name]:.3g}" for name in terms) or "–",
    )
