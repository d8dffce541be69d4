"""`avatarrex-studio render OUT`: pictures, folders of them and videos without a display. A wrong option needs no torch."""

from __future__ import annotations

import argparse
import os
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from avatarrex_studio.cli import edits, motion_options, options
from avatarrex_studio.cli.job import DEFAULT_SIZE, Job
from avatarrex_studio.cli.output import name_files, output_file
from avatarrex_studio.session.commands import SetBackground, SetCamera
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import LEVELS, Colour, StudioState

from avatarrex.capture.readers import choice
from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, what_is
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import floor_height, lowest
from avatarrex.signals.library import POSES, named_pose
from avatarrex.signals.read import read_motion
from avatarrex.stage.stage import Stage

AOVS = ("depth", "normal", "position", "mask")
FRAMING = {(True, True): "place", (True, False): "target", (False, True): "distance", (False, False): ""}
"""What is chosen where target or distance are not given."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """What is rendered, from where, and where it goes."""
    add = verb.add_argument
    add("out", help="OUT.png, OUT.mp4, or a folder for frame_000000.png …")
    add("--avatar", default="default", metavar="A", help="name, folder or .avatar file")
    add("--motion", metavar="FILE", help=motion_options.KINDS)
    which = verb.add_mutually_exclusive_group()
    which.add_argument("--frame", metavar="N", help="one frame of the motion")
    which.add_argument("--frames", metavar="A:B:S", help="frames A to B (not included) in steps of S")
    add("--size", metavar="N|WxH", help="pixels (512)")
    view = "azimuth, elevation, fov in degrees, distance in metres; x, y, z of the target; follow=0|1"
    add("--camera", metavar="K=V,…", help=view)
    settings = "body.left_elbow=0,0,45deg  face.jawOpen=0.6  left_hand.index1=0,0,-30deg  root.translation=0,0,1"
    add("--set", action="append", default=[], metavar="GROUP.NAME=VALUE", help=settings + "  shape.1=1")
    add("--pose", action="append", default=[], metavar="NAME", help="a named body pose")
    add("--hand", action="append", default=[], metavar="SIDE=NAME", help="a named hand pose: left=fist, both=relaxed")
    add("--expression", action="append", default=[], metavar="NAME", help="a named expression")
    add("--detail-from", metavar="POSE", help="feature patches of another pose: a named one, or MOTION:FRAME")
    level = StudioState().level
    add("--level", default=level, metavar="L", help=f"{', '.join(LEVELS)}: time against error ({level})")
    coarser = "sRGB of the error up to which pixels are interpolated between neighbours that are shaded: 0.004 (off)"
    add("--shading-tolerance", default="0", metavar="T", help=coarser)
    add("--alpha", action="store_true", help="transparent background (straight alpha)")
    add("--aov", metavar="NAMES", help=f"{','.join(AOVS)} as .npz beside the image")
    add("--background", metavar="COLOUR", help="name, #rrggbb, r,g,b or transparent")
    keys = ", ".join(options.STAGE)
    add("--stage", metavar="K=V,…", nargs="?", const="floor=1", help=f"floor, shadows and a soft background; {keys}")
    add("--stats", metavar="FILE.json", help="time and work of every frame")
    motion_options.add_import(verb)
    options.add_device(verb)


def run(arguments: Namespace) -> int:
    """Render and name the files. Raises `InputError`."""
    job = read_job(arguments)
    from avatarrex_studio.cli import headless
    from avatarrex_studio.engine.engine import Engine

    settings = RenderSettings(detail_from=job.detail, shading_tolerance=job.shading_tolerance)
    name_files(headless.run(job, Engine(settings=settings, device=arguments.device)))
    return 0


def read_job(arguments: Namespace) -> Job:
    """Read and check the options. Raises `InputError`."""
    options.refuse_empty(arguments, out="OUT")
    options.avatar(arguments.avatar)
    out = Path(arguments.out)
    kind = _kind(arguments.out, out)
    commands = edits.edits(arguments)
    view = edits.camera(arguments.camera) if arguments.camera else SetCamera()
    background = _background(arguments, kind)
    size = options.size(arguments.size) if arguments.size else DEFAULT_SIZE
    aovs = options.some_of("--aov", arguments.aov, AOVS) if arguments.aov else ()
    chosen = motion_options.import_options(arguments)
    motion = Motion.read(arguments.motion, chosen) if arguments.motion else None
    frames = _frames(arguments, motion, kind)
    stats = _stats(arguments)
    check_writable(out / "frame_000000.png" if kind == "folder" else out)
    level = options.one_of("--level", arguments.level, LEVELS)
    stage = (
        options.stage(arguments.stage, bool(arguments.background or arguments.alpha)) if arguments.stage else Stage()
    )
    state = StudioState(avatar=arguments.avatar, limit_joints=False, level=level, stage=stage)
    state = SetBackground(background).apply(view.apply(state))
    framing = FRAMING[view.target is None, view.distance is None]
    detail, coarser = _detail(arguments.detail_from), _shading_tolerance(arguments.shading_tolerance)
    job = Job(out, kind, state, motion, frames, commands, size, aovs, stats, detail, framing, coarser)
    _, first = next(job.states())  # an edit that cannot be applied is refused now
    return replace(job, start=_under(job.start, first))


def _under(state: StudioState, first: StudioState) -> StudioState:
    """`state` with the floor, unless its height was given, under the lowest point of the `first` frame."""
    if not state.stage.shown or state.stage.height is not None:
        return state
    low = lowest(first.signals.full_pose()[None], first.signals.translation[None])[0]
    return state.change(stage=replace(state.stage, height=float(floor_height() + low)))


def _kind(text: str, out: Path) -> str:
    found = what_is(out)
    if text.endswith("/") or found == "a folder" or not out.suffix:
        if found not in ("a folder", "nothing there"):
            raise InputError(out, "", "a folder, OUT.png or OUT.mp4", "a file without an extension")
        return "folder"
    kinds = {".png": "image", ".mp4": "video"}
    if out.suffix.lower() not in kinds:
        raise InputError(out, "", "OUT.png, OUT.mp4 or a folder", out.suffix)
    return kinds[out.suffix.lower()]


def _background(arguments: Namespace, kind: str) -> Colour:
    colour = edits.background(arguments.background) if arguments.background else StudioState().background
    if arguments.alpha:
        colour = (0.0, 0.0, 0.0, 0.0)
    if kind == "video" and colour[3] < 1:
        option = "--alpha" if arguments.alpha else "--background"
        raise InputError(option, "", "an opaque background for .mp4", "a transparent one")
    return colour


def _frames(arguments: Namespace, motion: Motion | None, kind: str) -> tuple[int, ...]:
    if motion is None:
        options.refuse_without_motion(arguments, "frame", "frames")
        motion_options.refuse_without_motion(arguments)
        if kind == "video":
            raise InputError(arguments.out, "", "--motion FILE for a video", "no motion")
        return (0,)
    if arguments.frame is not None:
        return (options.frame(arguments.frame, len(motion)),)
    if arguments.frames is None:
        return (0,) if kind == "image" else tuple(range(len(motion)))
    chosen = choice.frames(arguments.frames, len(motion))
    if kind == "image" and len(chosen) > 1:
        raise InputError(arguments.out, "", f"a folder or OUT.mp4 for {len(chosen)} frames", "one image")
    return chosen


def _stats(arguments: Namespace) -> Path | None:
    if not arguments.stats:
        return None
    path = output_file(arguments.stats, "FILE.json")
    if arguments.motion and os.path.realpath(path) == os.path.realpath(arguments.motion):
        raise InputError("--stats", "", "another file than the motion", arguments.stats)
    return path


def _shading_tolerance(text: str) -> float:
    """sRGB."""
    value = options.number("--shading-tolerance", "", text)
    if not 0 <= value <= 1:
        raise InputError("--shading-tolerance", "", "a number from 0 to 1, such as 0.004", text)
    return value


def _detail(text: str | None) -> Signals | None:
    """A named pose, or a motion file with `:FRAME` (0 unless given)."""
    if text is None:
        return None
    if text in POSES:
        return Signals.rest().replace(body_pose=named_pose(text))
    path, _, number = text.rpartition(":") if not os.path.exists(text) else (text, "", "0")
    if not path or not os.path.exists(path):
        raise InputError("--detail-from", "", "a named pose, or a motion file with :FRAME", text)
    sequence = read_motion(path)
    return sequence[options.frame(number, len(sequence), "--detail-from")]
