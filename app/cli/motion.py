"""`avatarrex-studio motion check|list`: how a motion file is read, beside its own skeleton; the motions of the program."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from avatarrex_studio.cli import motion_options, options

from avatarrex.errors import InputError, plain
from avatarrex.files.gate import check_writable
from avatarrex.signals.contacts import contact_report
from avatarrex.signals.ground import lowest
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.own_motions import MOTIONS
from avatarrex.signals.read import import_motion

NAME, OPTION = 16, 15
"""Letters of two columns: `right_shoulder` and a space, `--expressions` and two."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """Each act with its own."""
    acts = verb.add_subparsers(dest="act", metavar="ACT", required=True)
    what = "what was guessed about a motion, what looks wrong, and its skeleton beside the avatar"
    check = acts.add_parser("check", help=what, allow_abbrev=False)
    check.add_argument("file", help=motion_options.KINDS)
    check.add_argument("out", nargs="?", metavar="OUT.png", help="frames of the file's skeleton and of the avatar")
    check.add_argument("--avatar", default="default", metavar="A", help="name, folder or .avatar file")
    check.add_argument("--frames", metavar="A:B:S", help="frames that are drawn (6, evenly spaced)")
    motion_options.add_import(check)
    acts.add_parser("list", help="motions that come with the program", allow_abbrev=False)


def run(arguments: argparse.Namespace) -> int:
    """Print; draw where a picture is named. Raises `InputError`."""
    if arguments.act == "list":
        print("\n".join(f"{name:8s}{what}" for name, what in MOTIONS.items()))
        return 0
    options.refuse_empty(arguments, file="FILE", out="OUT.png")
    if arguments.out and Path(arguments.out).suffix.lower() != ".png":
        raise InputError(arguments.out, "", "OUT.png", Path(arguments.out).suffix or "no extension")
    if arguments.frames and not arguments.out:
        raise InputError("--frames", "", "OUT.png with it", "no picture")
    options.avatar(arguments.avatar)
    chosen = motion_options.import_options(arguments)
    if arguments.out:
        check_writable(arguments.out)
    imported = import_motion(arguments.file, chosen)
    print("\n".join(table(arguments.file, imported)))
    if arguments.out:
        from avatarrex_studio.sheets.motion_check import draw

        draw(imported, arguments.avatar, arguments.frames, Path(arguments.out))
        print(arguments.out)
    return 0


def table(path: str, imported: ImportedMotion) -> list[str]:
    """What was decided, how far directions are off, and every warning, in lines."""
    first, second = NAME, max(len(guess.value) for guess in imported.guesses) + 2
    lines = [f"{path}: {len(imported.sequence)} frames, {imported.sequence.duration:.2f} s", ""]
    lines += [f"  {'':{first}}{'taken as':{second}}change by"]
    for guess in imported.guesses:
        option = {"joints": "--map", "": ""}.get(guess.option, f"--{guess.option.replace('_', '-')}")
        lines.append(f"  {guess.what:{first}}{guess.value:{second}}{option:{OPTION}}{guess.why}".rstrip())
    if imported.errors:
        lines += ["", f"  {'directions':{first}}off from the file's own forward kinematics, degrees: median, largest"]
        lines += [
            f"  {part:{first}}{median:6.1f} {largest:6.1f}" for part, (median, largest) in imported.errors.items()
        ]
    pose, places = (np.stack(rows) for rows in zip(*((f.full_pose(), f.translation) for f in imported.sequence)))
    low = lowest(pose, places)
    heights = ", ".join(f"{100 * height:.1f}" for height in np.percentile(low, (5, 50, 95)))
    lines += ["", f"  {'over the floor':{first}}lowest point, cm: {heights} (5 %, median, 95 % of the frames)"]
    for side, foot in contact_report(pose, places, imported.sequence.fps).items():
        slide = f"slides {100 * foot.slide:.1f} on average, {100 * foot.farthest:.1f} at most"
        words = f"{foot.spans} contacts; {slide}; sinks {100 * foot.sink:.1f} at most"
        lines.append(f"  {side + ' foot':{first}}stands, cm: {words}")
    if imported.skeleton:
        lines += ["", f"  {'joint':{first}}in the file"]
        lines += [f"  {ours:{first}}{theirs}" for ours, theirs in _body(imported.skeleton.mapped).items()]
    lines += ["", *(f"  warning: {text}" for text in imported.warnings or ())]
    if not imported.warnings:
        lines.append("  nothing looks wrong")
    return [plain(line) for line in lines]


def _body(mapped: dict[str, str]) -> dict[str, str]:
    """The body's joints; fingers are counted above."""
    return {ours: theirs for ours, theirs in mapped.items() if ours[-1:] not in "123" or ours.startswith("spine")}
