"""`avatarrex-studio inspect PATH`: what a file is."""

from __future__ import annotations

import argparse

from avatarrex_studio.cli.inspection import describe


def add_options(verb: argparse.ArgumentParser) -> None:
    """The file."""
    verb.add_argument("path", help="a file or folder")


def run(arguments: argparse.Namespace) -> int:
    """Print a few lines about it. Raises `InputError`."""
    print("\n".join(describe(arguments.path)))
    return 0
