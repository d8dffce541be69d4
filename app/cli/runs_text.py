"""Runs as a table of text, one line each, for a terminal without a display. Plain, or live until Ctrl+C."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from avatarrex_studio.jobs.run_view import RunView, duration
from avatarrex_studio.jobs.runs import Runs

from avatarrex.errors import InputError

SECONDS = 1.0
"""Between two drawings of a live table."""
HEADS = ("RUN", "STATE", "PART", "PASS", "STEP", "STEPS/S", "PSNR", "SSIM", "ETA", "LOSSES")
RIGHT = ("STEP", "STEPS/S", "PSNR", "SSIM", "ETA")
COLOURS = {"running": 32, "paused": 33, "finished": 36, "failed": 31, "dead": 31}
"""ANSI colours of the states."""


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
        lines = table(runs.views, width if terminal else None, colour=terminal)
        if not runs.views:
            lines = [f"no runs below {folder}"]
        if terminal and not once:
            print("\x1b[H\x1b[2J", end="")
        print("\n".join(lines), flush=True)
        if once:
            return 0
        time.sleep(SECONDS if terminal else 10 * SECONDS)


def table(views: Sequence[RunView], width: int | None = None, colour: bool = False) -> list[str]:
    """Head and one line per run, cut to `width` columns."""
    rows = [dict(zip(HEADS, row(view))) for view in views]
    widths = {head: max([len(head), *(len(entry[head]) for entry in rows)]) for head in HEADS}
    lines = [_line(dict(zip(HEADS, HEADS)), widths)[:width].rstrip()]
    for view, entry in zip(views, rows):
        line = _line(entry, widths)[:width].rstrip()
        if colour and view.state in COLOURS:
            line = line.replace(f" {view.state} ", f" \x1b[{COLOURS[view.state]}m{view.state}\x1b[0m ", 1)
        lines.append(line)
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


def _line(entry: dict[str, str], widths: dict[str, int]) -> str:
    return "  ".join(
        entry[head].rjust(widths[head]) if head in RIGHT else entry[head].ljust(widths[head]) for head in HEADS
    )
