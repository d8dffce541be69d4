"""`avatarrex-studio`: the window, headless rendering, replay of a session, and what a file is.

Wrong input ends with one line, `avatarrex-studio: error: …`, and exit code 2; Ctrl+C with 130.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from avatarrex_studio.cli import bench, stress
from avatarrex_studio.cli.parser import PROGRAM, parser
from avatarrex_studio.engine.pages import keep_pages

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if (
        words
        and words[0] not in VERBS
        and (words[0].startswith("--device") or (not words[0].startswith("-") and os.path.exists(words[0])))
    ):
        words.insert(0, "open")
    try:
        if " ".join(words[:2]) == bench.ABLATION:
            words[:2] = [bench.ABLATION]
        arguments = parser().parse_args(_joined(words))
        keep_pages()
        return VERBS[arguments.verb or "open"](arguments)
    except InputError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read our words has left (`… | head`); nothing more can be said to them
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # 128 + SIGPIPE
    except (OSError, MemoryError) as error:
        name = getattr(error, "filename", None) or "this machine"
        said = getattr(error, "strerror", None) or "not enough memory"
        print(f"{PROGRAM}: error: {name}: {said}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return 130


def _joined(words: list[str]) -> list[str]:
    """Lets an option's value start with a minus: `--frames -10:-1` reads as `--frames=-10:-1`."""
    taking = ("--frame", "--frames", "--held-out-frames", "--size", "--camera")
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in taking and word.startswith("-") and not word.startswith("--"):
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def _open(arguments: argparse.Namespace) -> int:
    if _no_display(f"{PROGRAM} render OUT.png"):
        return 2
    from avatarrex_studio.window.window import run_window

    return run_window(getattr(arguments, "source", "default"), getattr(arguments, "device", "cpu"))


def _runs(arguments: argparse.Namespace) -> int:
    if arguments.text or arguments.once:
        from avatarrex_studio.cli.runs_text import show

        return show(arguments.folder, arguments.once)
    if _no_display(f"{PROGRAM} runs {arguments.folder} --text"):
        return 2
    from avatarrex_studio.window.runs_window import run_window

    return run_window(arguments.folder)


def _no_display(instead: str) -> bool:
    """Whether there is no display to open a window on; says so, and what to do `instead`."""
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return False
    print(f"{PROGRAM}: error: no display; without one use `{instead}`", file=sys.stderr)
    return True


def _render(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli.job import read_job

    job = read_job(arguments)
    from avatarrex_studio.cli import (
        headless,  # needs torch, which takes seconds to load: wrong options are refused before
    )
    from avatarrex_studio.engine.engine import Engine

    from avatarrex.pipeline import RenderSettings

    settings = RenderSettings(detail_from=job.detail)
    _say(headless.run(job, Engine(settings=settings, device=arguments.device)))
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli import options
    from avatarrex_studio.cli.job import DEFAULT_SIZE, Job
    from avatarrex_studio.session.journal import Journal

    state = Journal.load(arguments.session).state
    out = Path(arguments.out or Path(arguments.session).with_suffix(".png"))
    if out.suffix.lower() != ".png":
        raise InputError(out, "", "OUT.png", out.suffix or "no extension")
    check_writable(out)
    size = options.size(arguments.size) if arguments.size else state.size.fixed or DEFAULT_SIZE
    job = Job(out, "image", state, None, (0,), (), size, (), None)
    from avatarrex_studio.cli import headless
    from avatarrex_studio.engine.engine import Engine

    _say(headless.run(job, Engine()))
    return 0


def _inspect(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli.inspection import describe

    print("\n".join(describe(arguments.path)))
    return 0


def _capture(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli import capture_check, capture_make

    return {"check": capture_check.run, "make": capture_make.run}[arguments.act](arguments)


def _train(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli import train

    return train.run(arguments)


def _evaluate(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli import evaluate

    return evaluate.run(arguments)


def _sheet(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.cli.sheet_order import read_order

    order = read_order(arguments)
    from avatarrex_studio.cli import sheet  # needs torch

    return sheet.run(order)


def _say(written: list[Path]) -> None:
    if len(written) > 6:
        print(f"{written[0]} … {written[-1]} ({len(written)} files)")
    else:
        print("\n".join(map(str, written)))


VERBS: dict[str, Callable[[argparse.Namespace], int]] = {
    "open": _open,
    "render": _render,
    "replay": _replay,
    "inspect": _inspect,
    "capture": _capture,
    "evaluate": _evaluate,
    "sheet": _sheet,
    "train": _train,
    "runs": _runs,
    "bench": bench.run,
    bench.ABLATION: bench.run_ablation,
    "stress": stress.run,
}
"""What each does; without a verb the window opens."""
