"""`avatarrex-studio sheet AVATAR OUT_DIR`: contact sheets of an avatar. What is wrong is refused before torch is loaded."""

from __future__ import annotations

import argparse
from argparse import Namespace

from avatarrex_studio.cli import options
from avatarrex_studio.cli.motion_options import KINDS
from avatarrex_studio.cli.output import output_folder, write_json
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.sheets.order import COLUMNS, MOST, SHEETS, TRUTHS, SheetOrder

from avatarrex.capture.readers import choice
from avatarrex.errors import InputError
from avatarrex.files.gate import what_is

MOST_SAMPLES = 4
"""Most samples along a pixel's side."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """The avatar, which sheets, and where they go."""
    add = verb.add_argument
    add("avatar", help="name, folder or .avatar file")
    add(
        "out",
        metavar="OUT_DIR",
        help="a folder for body.jpg, face.jpg, hands.jpg, motion.jpg, close.jpg and sheet.json",
    )
    words = "ground truth beside every picture: " + ", ".join(TRUTHS)
    add(
        "--truth",
        metavar="S",
        help=f"{words} (the clothed subject), or a capture (its own pictures, cameras and poses)",
    )
    add(
        "--mesh", action="store_true", help="with --truth CAPTURE: the textured mesh with its skin fitted, between them"
    )
    add("--motion", metavar="FILE", help=f"motion.jpg: frames of {KINDS}")
    add("--other", metavar="AVATAR2", help="a second avatar, in the motion and close-ups")
    add("--frames", metavar="A:B:S", help=f"frames of the motion ({COLUMNS}, evenly spaced)")
    add("--only", metavar="NAMES", help=f"some of {','.join(SHEETS)} (all)")
    options.add_levels(verb)
    add("--samples", default="2", metavar="N", help="samples averaged along each side of a pixel (2)")


def run(arguments: Namespace) -> int:
    """Draw, print what floats. Raises `InputError`."""
    order = read_order(arguments)
    from avatarrex_studio.sheets import draw

    write_json(order.out / "sheet.json", draw.run(order))
    return 0


def read_order(arguments: Namespace) -> SheetOrder:
    """Read and check the options. Raises `InputError`."""
    options.refuse_empty(arguments, avatar="AVATAR", out="OUT_DIR")
    for avatar in filter(None, (arguments.avatar, arguments.other)):
        options.avatar(avatar)
    if arguments.truth is not None and arguments.truth not in TRUTHS and what_is(arguments.truth) == "nothing there":
        raise InputError("--truth", "", ", ".join([*TRUTHS, "or a capture, a folder or a .zip file"]), arguments.truth)
    captured = arguments.truth is not None and arguments.truth not in TRUTHS
    if arguments.mesh and not captured:
        raise InputError("--mesh", "", "--truth CAPTURE with it", arguments.truth or "no truth")
    samples = options.whole("--samples", arguments.samples, 1, MOST_SAMPLES, f"1 to {MOST_SAMPLES}")
    levels = options.levels(arguments.levels)
    motion = Motion.read(arguments.motion) if arguments.motion is not None else None
    only = _only(arguments, captured)
    if motion is None:
        options.refuse_without_motion(arguments, "frames")
    if arguments.other is not None and not {"motion", "close"} & set(only):
        raise InputError(
            "--other", "", "--motion FILE or --truth CAPTURE with it, and the sheet motion or close", ", ".join(only)
        )
    frames = _frames(arguments.frames, motion) if motion else ()
    out = output_folder(arguments.out, "sheet.json")
    truth = TRUTHS.get(arguments.truth, arguments.truth)
    return SheetOrder(
        arguments.avatar, out, only, truth, arguments.mesh, arguments.other, motion, frames, samples, levels
    )


def _only(arguments: Namespace, captured: bool) -> tuple[str, ...]:
    """The sheets that are named, or all for which there is what they show; in their order."""
    named = options.some_of("--only", arguments.only, SHEETS) if arguments.only else ()
    left_out = {"motion"} if arguments.motion is None else set()
    left_out |= set() if captured else {"close"}
    if "motion" in left_out.intersection(named):
        raise InputError("--only", "motion", "--motion FILE with it", "no motion")
    if "close" in left_out.intersection(named):
        raise InputError("--only", "close", "--truth CAPTURE with it", arguments.truth or "no truth")
    return tuple(name for name in SHEETS if name in (named or SHEETS) and name not in left_out)


def _frames(text: str | None, motion: Motion) -> tuple[int, ...]:
    if text is None:
        shown = min(COLUMNS, len(motion))
        return tuple(k * len(motion) // shown for k in range(shown))
    chosen = choice.frames(text, len(motion))
    if len(chosen) > MOST:
        raise InputError("--frames", "", f"at most {MOST} frames on a sheet", f"{text}, {len(chosen)} frames")
    return chosen
