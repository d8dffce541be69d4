"""`avatarrex-studio inspect PATH`: what a file or folder is and what it contains, said in a few lines."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

import numpy as np
from avatarrex_studio.jobs.file_kind import (
    AVATAR,
    CAPTURE,
    FOREIGN,
    MOTION,
    PICTURE,
    RUN,
    SESSION,
    how_to_import,
    kind_of,
)
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.timeline import Timeline

from avatarrex.errors import plain
from avatarrex.files.json_text import parse_json

if TYPE_CHECKING:
    from avatarrex.parts.known_expressions import KnownExpressions

WIDTH = 160
"""Of a value, characters."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """The file."""
    verb.add_argument(
        "path", nargs="?", help="a file or folder; without one: what this machine has of what the studio can use"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print a few lines about it. Raises `InputError`."""
    if arguments.path is None:
        from avatarrex_studio.jobs.available import available, lines  # torch

        print("\n".join(lines(available())))
        return 0
    print("\n".join(describe(arguments.path)))
    return 0


def describe(path: str) -> list[str]:
    """Lines about the file at `path`, without control characters. Raises `InputError` for what cannot be read."""
    return [plain(line) for line in _lines(path)]


def _lines(path: str) -> list[str]:
    tellers = {
        AVATAR: _avatar, MOTION: _motion, CAPTURE: _capture, FOREIGN: _foreign, RUN: _run, SESSION: _session, PICTURE: _picture,
    }  # fmt: skip
    return tellers[kind_of(path)](path)


def _avatar(path: str) -> list[str]:
    from avatarrex.avatar_file import load_avatar  # torch: a wrong file is refused without it

    avatar = load_avatar(path)
    counts = {
        name: sum(parameter.numel() for parameter in module.parameters()) for name, module in avatar.modules().items()
    }
    kept = {name: value for name, value in avatar.meta.items() if isinstance(value, str | int | float)}
    return [
        f"{path}: an avatar of {avatar.person.name} ({avatar.person.hash})",
        *(f"  {name}: {value}" for name, value in kept.items()),
        *_training(avatar.meta.get("training")),
        *_expressions(avatar.known_expressions),
        "  surface: " + (f"{len(avatar.surface.faces):,} triangles" if avatar.surface else "none"),
        *(f"  {name} field: {count:,} parameters" for name, count in counts.items()),
    ]


def _training(found: object) -> list[str]:
    """How the avatar was trained, a line a fact: values as they stand, of an object each entry."""
    if not isinstance(found, dict):
        return []
    lines = []
    for name, value in found.items():
        if name == "expressions":  # said by name
            continue
        if name == "splits" and isinstance(value, dict):
            lines += _splits(value)
        elif value == {}:
            lines.append(f"  training: {name}: none")
        elif isinstance(value, dict):
            lines += [f"  training: {name}: {key}: {_short(each)}" for key, each in value.items()]
        else:
            lines.append(f"  training: {name}: {_short(value)}")
    return lines


def _splits(found: dict[str, object]) -> list[str]:
    """A line for each rig and split: frames and cameras, whole."""
    lines = []
    for rig, by_split in found.items():
        for split, said in by_split.items() if isinstance(by_split, dict) else ():
            lines.append(f"  training: splits: {rig} rig, {split}: {json.dumps(said)}")
    return lines


def _expressions(known: KnownExpressions | None) -> list[str]:
    """The coefficients of ψ that no picture of the training showed."""
    if known is None:
        return []
    names = ", ".join(known.never_shown) or "none"
    return [f"  expressions that no picture showed, which move as the template does: {names}"]


def _short(value: object) -> str:
    """A text as it is, all else as JSON, of at most `WIDTH` characters."""
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= WIDTH else text[: WIDTH - 1] + "…"


def _motion(file: str) -> list[str]:
    motion = Motion.read(file)
    sequence = motion.sequence
    return [
        f"{file}: a motion of {len(motion)} frames at {sequence.fps:g} frames a second ({sequence.duration:.2f} s)",
        "  drives: " + (", ".join(motion.parts) or "nothing"),
        *(f"  {note}" for note in sequence.notes),
    ]


def _capture(path: str) -> list[str]:
    from avatarrex_studio.jobs.opening import contents  # torch

    from avatarrex.capture.readers.rigs import open_capture

    capture = open_capture(path)
    return [f"{path}: a capture", f"  {contents(capture)}", *(f"  {note}" for note in capture.notes)]


def _foreign(path: str) -> list[str]:
    return [f"{path}: {how_to_import(path)}"]


def _run(path: str) -> list[str]:
    from avatarrex_studio.jobs.opening import newest_run  # torch

    run = newest_run(path)
    about = {name: run.about.get(name) for name in ("capture", "preset", "note")}
    return [
        f"{run.path}: a run, {run.state}, step {run.step:,}" + (f" of {run.steps:,}" if run.steps else ""),
        *(f"  {name}: {value}" for name, value in about.items() if value),
        f"  avatar: {run.avatar or 'none yet'}",
    ]


def _layers(timeline: Timeline) -> list[str]:
    """The motions and other layers of a timeline, and where it stands."""
    if not timeline.layers:
        return []
    names = [layer.clip.path if layer.clip else layer.name for layer in timeline.layers]
    return [f"  timeline: {', '.join(names)}; frame {timeline.frame} of {timeline.frames}"]


def _figures(state: StudioState) -> list[str]:
    """Avatar and timeline of each."""
    return [line for figure in state.figures for line in (f"  avatar: {figure.avatar}", *_layers(figure.timeline))]


def _session(file: str) -> list[str]:
    journal = Journal.load(file)
    state = journal.state
    return [
        f"{file}: a session of {len(journal.steps)} steps",
        *_figures(state),
    ]


def _picture(file: str) -> list[str]:
    """What the studio wrote into a picture: the state that it shows, and the invisible mark."""
    from avatarrex.files import images, watermark  # torch: a wrong file is refused without it

    png = file.lower().endswith(".png")
    (width, height), text = images.read_png_text(file, "avatarrex") if png else images.read_jpeg_text(file)
    lines = [
        f"{file}: a picture of {width}x{height} pixels",
        *_mark(watermark.score(images.read_pixels(file)), watermark.FOUND),
    ]
    if text is None or not (png or text.startswith("{")):
        return [*lines, f"  not rendered by the studio: no {'text' if png else 'comment'} 'avatarrex'"]
    state = StudioState.from_json(parse_json(text, file, "avatarrex"), f"{file}: avatarrex")
    moved = [name for name, value in vars(state.signals).items() if np.any(value)]
    view = state.view
    return [
        *lines,
        *_figures(state),
        f"  level: {state.level}",
        f"  camera: azimuth {view.azimuth:g}, elevation {view.elevation:g}, {view.distance:g} m, {view.fov:g} degrees",
        "  not at rest: " + (", ".join(moved) or "nothing"),
    ]


def _mark(score: float, found: float) -> list[str]:
    """Whether there is an invisible mark."""
    return (
        [f"  invisible mark: found (score {score:.1f}, {found:g} needed)"]
        if score >= found
        else ["  invisible mark: none"]
    )
