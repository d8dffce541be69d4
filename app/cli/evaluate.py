"""`avatarrex-studio evaluate AVATAR CAPTURE`: an avatar against a capture, as a table, JSON and a contact sheet."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from avatarrex_studio.cli import options
from avatarrex_studio.cli.output import output_file, write_json

from avatarrex.capture.readers import choice
from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable

if TYPE_CHECKING:
    from avatarrex.avatar import Avatar
    from avatarrex.capture.readers.rigs import Capture, Rig
    from avatarrex.templates.person import Person

OTHER_BODY = "avatar: made on another body than the capture's; it is posed on its own"
SHEET = 8
"""Pictures on a contact sheet."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """What is compared, and where the figures go."""
    add = verb.add_argument
    add("avatar", help="name, folder or .avatar file")
    add("capture", help="a folder or .zip")
    add("--rig", choices=("body", "face"), help="body, where there is one")
    add(
        "--frames",
        metavar="A:B:S,…",
        help="frames A to B (not included) in steps of S, or held-out: all of them (4 of each split)",
    )
    add("--views", metavar="NAMES", help="cameras by name or number, comma separated (all)")
    options.add_held_out(verb, "cameras", "that were not trained on")
    add("--size", metavar="N", help="pixels of the longer side at most (the capture's)")
    samples = "samples averaged along each side of a pixel (1, what the window shows)"
    options.add_levels(verb)
    add("--samples", default="1", metavar="N", help=samples)
    add(
        "--baselines",
        action="store_true",
        help="beside it the template: naked, textured and in one colour; textured with its skin fitted to the mattes",
    )
    add("--face-only", action="store_true", help="everything cut by where the fitted face is seen")
    add("--exposed-as", metavar="RIG", help="pictures as the cameras of another rig would have taken them")
    add("--json", metavar="FILE.json", help="every figure")
    add("--sheet", metavar="OUT.png", help="a contact sheet: ground truth, avatar, difference")
    add("--vgg", metavar="FILE", help="vgg16-397923af.pth, for LPIPS (or AVATARREX_VGG, or torch hub's folder)")
    add("--lpips", metavar="FILE", help="the linear heads: lpips' vgg.pth or its wheel (or AVATARREX_LPIPS)")
    add("--inception", metavar="FILE", help="pt_inception-2015-12-05-6726825d.pth, for FID (or AVATARREX_INCEPTION)")
    options.add_device(verb)


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, print the table, write the files. Raises `InputError` before any work for a wrong option."""
    size = None
    if arguments.size is not None:
        size = options.whole("--size", arguments.size, 32, 8192, "32 to 8192 pixels of the longer side")
    samples = options.whole("--samples", arguments.samples, 1, 8, "1 to 8 samples along a pixel's side")
    levels = options.levels(arguments.levels)
    if arguments.json is not None:
        check_writable(arguments.json)
    sheet = output_file(arguments.sheet, "OUT.png") if arguments.sheet is not None else None
    if arguments.face_only and size is not None:
        own = "the pictures' own with --face-only: its mattes are cut pixel by pixel"
        raise InputError("--size", "", own, size)
    return _evaluate(arguments, size, (levels, samples), sheet)


def _evaluate(
    arguments: argparse.Namespace, size: int | None, drawn: tuple[tuple[str, ...], int], sheet: Path | None
) -> int:
    """`drawn`: at which levels, with how many samples a pixel's side."""
    from avatarrex.avatar_file import load_avatar
    from avatarrex.capture.readers.rigs import open_capture
    from avatarrex.capture.readers.splits import with_validation
    from avatarrex.files.images import write_png
    from avatarrex.metrics import baselines, drawing, evaluate, face_region, measures, report
    from avatarrex.metrics.own_training import as_trained
    from avatarrex.training.core import exposure

    weights = (arguments.vgg, arguments.lpips, arguments.inception)
    networks = measures.Networks.load(*(Path(path) if path else None for path in weights))
    avatar = load_avatar(arguments.avatar, arguments.device)
    whole = with_validation(open_capture(arguments.capture, template=avatar.person.name))
    capture, own = as_trained(avatar, arguments.avatar, whole)
    name = arguments.rig or ("body" if "body" in capture.rigs else next(iter(capture.rigs)))
    rig = capture.rigs[options.one_of("--rig", name, capture.rigs)]
    rig = choice.held_out(rig, arguments.held_out_frames, arguments.held_out_views)
    capture = replace(capture, rigs={**capture.rigs, name: rig})
    exposed: dict[str, object] = {}
    if arguments.exposed_as:
        capture = exposure.one_exposure(capture, arguments.exposed_as, avatar.person if own else capture.person)
        rig, exposed = _exposed(capture, name, arguments.exposed_as)
    frames = _frames(arguments.frames, rig.held_out_frames, rig.frames) if arguments.frames else None
    views = choice.cameras(rig, arguments.views, "--views") if arguments.views else None
    notes = () if own or avatar.person.hash == capture.person.hash else (OTHER_BODY,)
    for note in (*capture.notes, *notes):
        print(note, file=sys.stderr)
    start = time.perf_counter()
    subjects: list[drawing.Drawer] = [*drawing.by_level("avatar", avatar, *drawn)]
    fitted = _person_fitted(avatar, capture, own) if arguments.baselines or arguments.face_only else capture.person
    if arguments.baselines:
        subjects += baselines.rivals(capture, fitted, list(evaluate.observations(rig)))
    if arguments.face_only:
        rig, subjects = face_region.face_alone(fitted, rig, subjects)
        capture = replace(capture, ground_truth={})
    shown = SHEET if sheet else 0
    chosen = evaluate.Choice(frames, views, size, shown)
    found = evaluate.evaluate(capture, rig, subjects, networks, chosen, progress=True)
    print(report.table(found))
    if arguments.json:
        seconds = time.perf_counter() - start
        figures = report.to_json(found, arguments.avatar, arguments.capture, seconds)
        write_json(arguments.json, figures | exposed)
    if sheet:
        write_png(sheet, report.contact_sheet(found))
        print(sheet)
    return 0


def _exposed(capture: Capture, name: str, other: str) -> tuple[Rig, dict[str, object]]:
    """Rig `name` of a capture in one exposure, and what its pictures were multiplied by, for the figures' file."""
    from avatarrex.training.core.exposure import factors

    gain = factors(capture.rigs[name])
    times = ", ".join(f"{each:.2f}" for each in gain)
    print(f"{name} rig: pictures times {times}, as the {other} rig's", file=sys.stderr)
    return capture.rigs[name], {"exposed_as": {"rig": other, "gain": gain}}


def _person_fitted(avatar: Avatar, capture: Capture, own: bool) -> Person:
    """Whom a training on this capture poses: the avatar's body where that was it, else the person with its skin fitted."""
    from avatarrex.capture.fit.capture_fit import fit_geometry

    if own or capture.person.packaged or capture.person.hash == avatar.person.hash:
        return avatar.person if own else capture.person
    print("person: fitting the template's skin and face to the pictures", file=sys.stderr)
    return fit_geometry(capture)


def _frames(text: str, kept: frozenset[int], count: int) -> tuple[int, ...]:
    """All that are held out, or as listed."""
    return tuple(sorted(kept)) if text == "held-out" else choice.frames(text, count)
