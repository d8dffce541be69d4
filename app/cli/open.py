"""`avatarrex-studio open [AVATAR|SESSION]`: the window."""

from __future__ import annotations

import argparse
import os
import sys

from avatarrex_studio.cli import PROGRAM
from avatarrex_studio.cli.options import add_device


def add_options(verb: argparse.ArgumentParser) -> None:
    """What the window opens with."""
    verb.add_argument("source", nargs="?", default="default", help="an avatar or a saved session")
    add_device(verb)


def run(arguments: argparse.Namespace) -> int:
    """Open the window; returns once it is closed."""
    if no_display("render OUT.png"):
        return 2
    from avatarrex_studio.window.window import run_window

    return run_window(arguments.source, arguments.device)


def no_display(instead: str) -> bool:
    """Whether there is no display for a window; if so, prints which words to use `instead`."""
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return False
    print(f"{PROGRAM}: error: no display; without one use `{PROGRAM} {instead}`", file=sys.stderr)
    return True
