"""Options of every verb that reads a motion: what its reader would guess. Text in, `ImportOptions` out. Raises `InputError`."""

from __future__ import annotations

import argparse

from avatarrex_studio.cli.options import number

from avatarrex.errors import InputError
from avatarrex.files.json_text import read_json
from avatarrex.signals.import_options import AXES, FLOORS, RESTS, SHORT, ImportOptions
from avatarrex.signals.own_motions import MOTIONS

KINDS = (
    ".bvh, .amc, .fbx, .npz and .npy (SMPL, SMPL-X, AMASS, MANO, Faceverse, hand landmarks), .pkl (MANO), .csv (Live Link Face), "
    f".wav (the mouth), .json; or {', '.join(MOTIONS)}"
)
"""What `--motion` takes."""


def add_import(verb: argparse.ArgumentParser) -> None:
    """What a reader would guess otherwise."""
    group = verb.add_argument_group(
        "how the motion is read (guessed unless given; `motion check FILE` shows the guesses)"
    )
    add = group.add_argument
    add("--up", metavar="AXIS", help=f"up in the file: {', '.join(AXES)}")
    add("--forward", metavar="AXIS", help="what of the file looks at the camera (the person in the first frame)")
    add("--unit", metavar="U", help=f"{', '.join(SHORT)} or metres: of the path (scaled by the length of the leg)")
    add("--fps", metavar="N", help="frames a second")
    add("--rest", metavar="R", help=f"{' or '.join(RESTS)}: the rest pose is a person's, or a bundle of bones")
    add("--floor", metavar="F", help=f"{', '.join(FLOORS)}: what is put on the floor")
    add("--lock-feet", action="store_true", help="feet that stand neither slide nor sink")
    add("--side", metavar="SIDE", help="left or right, where a file of one hand does not say which")
    add("--hand-mean", metavar="M", help="flat, or the model file (SMPLX_*.npz, MANO_*.pkl) of the mean hand and PCA")
    add("--expressions", metavar="FILE.csv", help="the 52 coefficients by another face's (docs/signals.md)")
    add("--map", metavar="FILE.json", help='joints: {"left_knee": "shin_L", …}; an empty name leaves ours at rest')


def import_options(arguments: argparse.Namespace) -> ImportOptions:
    """Of the options of `add_import`, checked."""
    given = {
        name: getattr(arguments, name)
        for name in ("up", "forward", "unit", "rest", "floor", "side", "hand_mean", "expressions")
        if getattr(arguments, name)
    }
    if arguments.fps is not None:
        given["fps"] = number("--fps", "", arguments.fps)
    if arguments.lock_feet:
        given["lock_feet"] = True
    if arguments.map is not None:
        given["joints"] = read_json(arguments.map)
    try:
        return ImportOptions.from_json(given)
    except InputError as error:
        if error.source != "motion options":
            raise
        place = arguments.map if error.field == "joints" else f"--{error.field.replace('_', '-')}"
        raise InputError(place, "", error.expected, error.found) from None


def refuse_without_motion(arguments: argparse.Namespace) -> None:
    """Refuse options of `add_import` where no motion is given."""
    for name in ("up", "forward", "unit", "fps", "rest", "floor", "map", "side", "hand_mean", "expressions"):
        if getattr(arguments, name) is not None:
            raise InputError(f"--{name.replace('_', '-')}", "", "--motion FILE with it", "no motion")
    if arguments.lock_feet:
        raise InputError("--lock-feet", "", "--motion FILE with it", "no motion")
