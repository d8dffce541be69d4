"""`avatarrex-studio replay SESSION [OUT.png]`: the picture at the end of a saved session."""

from __future__ import annotations

import argparse
from pathlib import Path

from avatarrex_studio.cli import options
from avatarrex_studio.cli.job import DEFAULT_SIZE, Job
from avatarrex_studio.cli.output import name_files, output_file
from avatarrex_studio.session.journal import Journal


def add_options(verb: argparse.ArgumentParser) -> None:
    """The session, and where the picture goes."""
    verb.add_argument("session", help="a session saved by the window")
    verb.add_argument("out", nargs="?", help="OUT.png (beside the session unless given)")
    verb.add_argument("--size", metavar="N|WxH", help="pixels (512)")


def run(arguments: argparse.Namespace) -> int:
    """Render the last state. Raises `InputError`, before torch is loaded where it can."""
    state = Journal.load(arguments.session).state
    out = output_file(arguments.out or str(Path(arguments.session).with_suffix(".png")), "OUT.png")
    size = options.size(arguments.size) if arguments.size else state.size.fixed or DEFAULT_SIZE
    from avatarrex_studio.cli import headless
    from avatarrex_studio.engine.engine import Engine

    name_files(headless.run(Job(out, "image", state, size=size), Engine()))
    return 0
