"""`avatarrex-studio capture make|check|refine|match-exposure|import|prepare`: the synthetic capture, how well any fits together, better
tracking, one exposure for all cameras, other layouts, videos."""

from __future__ import annotations

import argparse
from pathlib import Path

from avatarrex_studio.cli import options
from avatarrex_studio.cli.output import output_folder

from avatarrex.capture.readers import choice
from avatarrex.errors import InputError
from avatarrex.training.recipe import RECIPES

FORMATS = ("folder", "zip")
MOST_COMPARED = 1000
"""Frames that `check` compares."""
LONGEST_STRIDE, RATES, HEIGHTS = 1000, (0.01, 1000.0), (0.4, 2.8)
"""Limits of `prepare`: frames, frames a second, metres."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """Each act with its own."""
    acts = verb.add_subparsers(dest="act", metavar="ACT", required=True)
    make = acts.add_parser("make", help="a synthetic capture of the default subject", allow_abbrev=False)
    make.add_argument("out", help="a new folder, or one to go on with; OUT.zip with --format zip")
    make.add_argument("--size", default="small", metavar="S", help="smoke, small or paper (small)")
    make.add_argument("--seed", default="0", metavar="N", help="varies motions, hands and expressions (0)")
    make.add_argument("--garment", default="printed", metavar="G", help="printed or loose (printed)")
    make.add_argument("--subject", default="default", metavar="P", help="default, or other: not the template (default)")
    make.add_argument("--expressions", metavar="E", help="template or own shapes (the subject's)")
    what = "all, or some of light,exposure,lens,noise,mattes,texture (none)"
    make.add_argument("--conditions", default="none", metavar="LIST", help=what)
    noise = "2 degrees a joint, 1 cm, 0.1 of the coefficients, times F (1; without the option exact)"
    make.add_argument("--tracking-noise", nargs="?", const="1", default="0", metavar="F", help=noise)
    make.add_argument("--format", default="folder", metavar="F", help="folder or zip (folder)")
    what = "how well a capture's pictures, cameras and parameters fit"
    check = acts.add_parser("check", help=what, allow_abbrev=False)
    check.add_argument("capture", help="a folder or .zip")
    check.add_argument("--out", metavar="DIR", help="contact sheets with the template over the images, and check.json")
    check.add_argument("--surface", action="store_true", help="fit the template's skin to the mattes first (a minute)")
    options.add_person(check, "default")
    check.add_argument("--rig", choices=("body", "face"), help="one rig alone")
    check.add_argument("--frames", default="4", metavar="N", help="how many frames to compare (4)")
    what = "a capture with its tracking refined by its own mattes, keypoints and colours"
    refine = acts.add_parser("refine", help=what, allow_abbrev=False)
    refine.add_argument("capture", help="a folder or .zip")
    refine.add_argument("out", help="a new folder, or one to go on with")
    options.add_person(refine, "default")
    every = "refine the poses of frames that are kept from training, too (by the training's cameras and shape)"
    refine.add_argument("--every-frame", action="store_true", help=every)
    refine.add_argument(
        "--no-colours", action="store_true", help="by mattes and keypoints alone, in less than half the time"
    )
    what = "a capture whose cameras have one exposure and white balance, by the colours of the person"
    match = acts.add_parser("match-exposure", help=what, allow_abbrev=False)
    match.add_argument("capture", help="a folder or .zip")
    match.add_argument("out", help="a new folder")
    options.add_person(match, "default")
    _add_import(acts)
    _add_prepare(acts)


def _add_import(acts: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """`import` with its own."""
    what = "a capture of another layout (AvatarReX, THuman4.0, ZJU-MoCap, ActorsHQ, IMAvatar, NeRFace) written in ours"
    imported = acts.add_parser("import", help=what, allow_abbrev=False)
    imported.add_argument("source", help="a folder or .zip")
    imported.add_argument("out", help="a new folder, or one to go on with")
    imported.add_argument("--unit", metavar="U", help="of the cameras' places: m, cm or mm (guessed)")
    imported.add_argument("--up", metavar="AXIS", help="of the file's world: +X, -X, +Y, -Y, +Z or -Z (guessed)")
    imported.add_argument(
        "--hands",
        metavar="H",
        help="what fingers at zero, or without parameters, are: flat, or the file's mean (as it says; relaxed)",
    )
    what = "N frames alone, to look at: the template over them is drawn into OUT/look"
    imported.add_argument("--preview", metavar="N", help=what)


def _add_prepare(acts: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """`prepare` with its own."""
    what = "a capture from videos, a calibration and keypoint files; goes on where it stopped"
    prepare = acts.add_parser("prepare", help=what, allow_abbrev=False)
    prepare.add_argument(
        "source", help="a folder: videos/ or images/, a calibration, keypoints/, mattes/ or background/"
    )
    prepare.add_argument("out", help="a new folder, or one to go on with")
    options.add_person(prepare, "default")
    prepare.add_argument("--stride", default="1", metavar="N", help="use every N-th frame (1)")
    prepare.add_argument("--fps", metavar="F", help="frames a second of the pictures, where no video says it (30)")
    prepare.add_argument(
        "--height", metavar="M", help="the person's height in metres, for calibrations without a unit (COLMAP)"
    )
    prepare.add_argument(
        "--redo", metavar="STEP", help="do cameras, pictures, mattes, keypoints, fit or face again, and what follows"
    )
    prepare.add_argument("--held-out-frames", metavar="A:B:S", help="frames kept from training, for `evaluate` alone")
    prepare.add_argument(
        "--no-refine", action="store_true", help="end before the refinement by mattes, keypoints and colours"
    )
    prepare.add_argument("--train", metavar="RECIPE", help="train an avatar at the end, e.g. quick, into OUT/run")


def run(arguments: argparse.Namespace) -> int:
    """Do what the act says. Raises `InputError`."""
    acts = {
        "make": _make,
        "check": _check,
        "refine": _refine,
        "match-exposure": _match_exposure,
        "import": _import,
        "prepare": _prepare,
    }
    return acts[arguments.act](arguments)


def _make(arguments: argparse.Namespace) -> int:
    out, seed = Path(arguments.out), options.whole("--seed", arguments.seed, 0)
    options.one_of("--format", arguments.format, FORMATS)
    archive = arguments.format == "zip"
    if (out.suffix.lower() == ".zip") != archive:
        raise InputError(out, "", "a name that ends in .zip with --format zip, and only then", arguments.format)
    noise = options.number("--tracking-noise", "", arguments.tracking_noise)
    from avatarrex.capture.synthetic.make import make_capture
    from avatarrex.capture.synthetic.variation import Variation, conditions

    varied = Variation(arguments.subject, arguments.expressions or "", conditions(arguments.conditions), noise)
    print(make_capture(out, arguments.size, seed, arguments.garment, archive, varied))
    return 0


def _check(arguments: argparse.Namespace) -> int:
    count = options.whole("--frames", arguments.frames, 1, MOST_COMPARED, f"1 to {MOST_COMPARED} frames")
    out = None if arguments.out is None else output_folder(arguments.out, "check.json")
    from avatarrex_studio.cli.capture_check import check

    return check(arguments.capture, arguments.person, arguments.rig, count, arguments.surface, out)


def _refine(arguments: argparse.Namespace) -> int:
    out = output_folder(arguments.out, "capture.json")
    from avatarrex_studio.cli.capture_refine import refine

    return refine(arguments.capture, arguments.every_frame, out, not arguments.no_colours, arguments.person)


def _match_exposure(arguments: argparse.Namespace) -> int:
    out = output_folder(arguments.out, "capture.json")
    from avatarrex_studio.cli.capture_exposure import match_exposure

    return match_exposure(arguments.capture, arguments.person, out)


def _import(arguments: argparse.Namespace) -> int:
    from avatarrex.capture.importers.corrections import HANDS, UNITS, UP, Corrections

    said = {}
    for name, known in (("unit", UNITS), ("up", UP), ("hands", HANDS)):
        value = getattr(arguments, name)
        said[name] = options.one_of(f"--{name}", value, known) if value is not None else ""
    some = None if arguments.preview is None else options.whole("--preview", arguments.preview, 1, MOST_COMPARED)
    out = output_folder(arguments.out, "capture.json")
    from avatarrex.capture.importers.import_capture import import_capture

    found = import_capture(Path(arguments.source), out, Corrections(**said), some)
    print("\n".join(found.lines()))
    print(out)
    if some is None or not found.posed:
        return 0
    from avatarrex_studio.cli.capture_check import check

    return check(str(out), "default", None, some, False, out / "look")


def _prepare(arguments: argparse.Namespace) -> int:
    out = output_folder(arguments.out, "prepare.json")
    stride = options.whole("--stride", arguments.stride, 1, LONGEST_STRIDE)
    fps = _within("--fps", arguments.fps, RATES)
    height = _within("--height", arguments.height, HEIGHTS)
    if arguments.train is not None:
        options.one_of("--train", arguments.train, RECIPES)
    from avatarrex_studio.cli.capture_prepare import prepare

    from avatarrex.capture.importers.preparing import Options
    from avatarrex.signals.sequence import MOST_FRAMES

    if arguments.held_out_frames is not None:  # its form: how many frames there are is not known yet
        choice.frames(arguments.held_out_frames, MOST_FRAMES, "--held-out-frames")
    chosen = Options(stride, fps, height, arguments.held_out_frames, arguments.person)
    return prepare(Path(arguments.source), out, chosen, arguments)


def _within(option: str, text: str | None, limits: tuple[float, float]) -> float | None:
    """A number within limits, where one is given."""
    value = None if text is None else options.number(option, "", text)
    if value is not None and not limits[0] <= value <= limits[1]:
        raise InputError(option, "", f"a number from {limits[0]:g} to {limits[1]:g}", text)
    return value
