"""`avatarrex-studio open [AVATAR|MOTION|CAPTURE|RUN|SESSION]`: the window."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from avatarrex_studio.cli import PROGRAM
from avatarrex_studio.cli.options import add_device
from avatarrex_studio.jobs.file_kind import AVATAR, FOREIGN, OPENS, PICTURE, how_to_import, kind_of

from avatarrex.errors import InputError

if TYPE_CHECKING:
    from avatarrex_studio.window.window import Window


def add_options(verb: argparse.ArgumentParser) -> None:
    """What the window opens with."""
    verb.add_argument(
        "source", nargs="?", default="default", help="an avatar, a motion, a capture, a run or a saved session"
    )
    add_device(verb)


def run(arguments: argparse.Namespace) -> int:
    """Open the window; returns once it is closed. Raises `InputError` before that for a path that is nothing to open."""
    kind = kind_of(arguments.source)
    if kind in (PICTURE, FOREIGN):
        found = "a picture" if kind == PICTURE else how_to_import(arguments.source)
        raise InputError(arguments.source, "", OPENS, found)
    if no_display("render OUT.png"):
        return 2
    from avatarrex_studio.window.starting import Starting, check_display

    check_display("avatarrex-studio render OUT.png")
    starting = Starting()

    def prepare() -> Window:
        starting.say("Loading the program…")
        from avatarrex_studio.engine.avatars import Avatars
        from avatarrex_studio.engine.live import read_avatar

        avatars = Avatars(read_avatar)
        if kind == AVATAR:  # read by a thread while the rest is imported
            avatars.keep(arguments.source, avatars.read(arguments.source))
        from avatarrex_studio.window.window import prepared

        starting.say(f"Reading {os.path.basename(arguments.source) or arguments.source}…")
        return prepared(arguments.source, avatars, arguments.device)

    window = starting.show_while(prepare)
    if window is None:
        return 0
    from avatarrex_studio.window.window import run as run_window

    return run_window(window)


def no_display(instead: str) -> bool:
    """Whether there is no display for a window; if so, prints which words to use `instead`."""
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return False
    print(f"{PROGRAM}: error: no display; without one use `{PROGRAM} {instead}`", file=sys.stderr)
    return True
