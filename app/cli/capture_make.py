"""`capture make`: the synthetic capture from the command line."""

from __future__ import annotations

import argparse
from pathlib import Path

from avatarrex.errors import InputError

FORMATS = ("folder", "zip")


def run(arguments: argparse.Namespace) -> int:
    """Make the capture and say where it is. Raises `InputError`."""
    from avatarrex.capture.synthetic.make import make_capture

    out = Path(arguments.out)
    if not arguments.seed.isdigit():
        raise InputError("--seed", "", "an integer from 0", arguments.seed or "nothing")
    if arguments.format not in FORMATS:
        raise InputError("--format", "", "one of " + ", ".join(FORMATS), arguments.format)
    if (out.suffix.lower() == ".zip") != (arguments.format == "zip"):
        raise InputError(out, "", "a name that ends in .zip with --format zip, and only then", arguments.format)
    print(make_capture(out, arguments.size, int(arguments.seed), arguments.garment, arguments.format == "zip"))
    return 0
