"""The front door of all that measures the product: `python -m avatarrex.measure NAME …`, `NAME --help` for its options.

`avatarrex-studio bench`, `bench ablation` and `stress` are the tools of these names. Nothing that runs the product imports
this package. A tool is a module with `add_options(parser)` and `run(options) -> int | None`, an exit status.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from avatarrex.errors import InputError, check

PROGRAM = "python -m avatarrex.measure"
TOOLS = {
    "bench": ("bench.command", "run time against error, stage by stage (docs/bench.md)"),
    "ablation": ("ablation.command", "what feature patches, pass II, sampling … are worth, trained for real (docs/ablations.md)"),
    "stress": ("stress.command", "hostile inputs through every stage (docs/stress.md)"),
    "accuracy": ("studies.accuracy", "how near an avatar is to the subject that it was fitted to"),
    "oracle": ("studies.oracle", "errors of every level against the exact frame; polish, seams, flicker"),
    "bent-joints": ("studies.bent_joints", "whether sharply bent joints have holes"),
    "ceiling": ("studies.ceiling", "how far a capture's own meshes, painted from the training's pictures, would come"),
    "face-regions": ("studies.face_regions", "eyes, mouth and face of an avatar and of the fitted mesh against a capture's"),
    "error-places": ("studies.error_places", "where inside the matte an avatar's squared error lies, and what held-out cameras add"),
    "sensor-noise": ("studies.sensor_noise", "what a perfect render would reach against noisy pictures"),
    "drag": ("studies.drag", "voxels and tolerance of a dragged limb: error against time"),
    "local-frames": ("studies.local_frames", "error and cost of every local frame"),
    "loops": ("studies.loops", "compiled loops of the body's colour beside torch"),
    "surface-errors": ("studies.surface_errors", "level live over motions that no surface was fitted to"),
    "surface-curve": ("studies.surface_curve", "a surface's error by fitted poses and directions"),
    "memory": ("studies.memory", "memory and OpenGL objects over many frames"),
}  # fmt: skip
"""Module of each tool, and what it measures."""


class Parser(argparse.ArgumentParser):
    """Refuses wrong words in one line."""

    program = PROGRAM

    def error(self, message: str) -> NoReturn:
        """Exit status 2."""
        self.exit(2, f"{self.program}: error: {message.splitlines()[0]}\n")


def run(words: Sequence[str], program: str = PROGRAM) -> int:
    """Run the tool that the first word names; `bench ablation` is `ablation`, too. Raises `InputError` for wrong options."""
    spelled = 2 if list(words[:2]) == ["bench", "ablation"] else 1
    name = "".join(words[spelled - 1 : spelled])
    check(name in TOOLS, "measure", "", ", ".join(TOOLS), name or "nothing")
    tool = import_module(f"avatarrex.measure.{TOOLS[name][0]}")
    parser = Parser(
        " ".join([program, *words[:spelled]]), description=tool.__doc__, allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.program = program
    tool.add_options(parser)
    return tool.run(parser.parse_args(words[spelled:])) or 0


def main(words: Sequence[str]) -> int:
    """Run a tool; wrong input is one line and status 2, Ctrl+C status 130."""
    if not words or words[0] in ("-h", "--help"):
        print(f"usage: {PROGRAM} NAME …\n", *(f"  {name:15}{what}" for name, (_, what) in TOOLS.items()), sep="\n")
        return 0
    try:
        return run(words)
    except InputError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
