"""`avatarrex-studio inspect PATH`: what a file is, an avatar, a motion, a session or a picture, said in a few lines."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState

from avatarrex.errors import InputError, plain
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import parse_json, read_json
from avatarrex.signals.own_motions import MOTIONS

WIDTH = 160
"""Of a value, characters."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """The file."""
    verb.add_argument("path", help="a file or folder")


def run(arguments: argparse.Namespace) -> int:
    """Print a few lines about it. Raises `InputError`."""
    print("\n".join(describe(arguments.path)))
    return 0


def describe(path: str) -> list[str]:
    """Lines about the file at `path`, without control characters. Raises `InputError` for what cannot be read."""
    return [plain(line) for line in _lines(path)]


def _lines(path: str) -> list[str]:
    file = Path(path)
    if path in MOTIONS:
        return _motion(file)
    found = "a file" if path == "default" else what_is(path)
    if found not in ("a file", "a folder"):
        raise InputError(path, "", "an avatar, a motion, a session or a picture", found)
    if path == "default" or found == "a folder" or file.suffix == ".avatar":
        return _avatar(path)
    if file.suffix == ".json" and _is_session(file):
        return _session(file)
    return _picture(file) if file.suffix == ".png" else _motion(file)


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
        "  surface: " + (f"{len(avatar.surface.faces):,} triangles" if avatar.surface else "none"),
        *(f"  {name} field: {count:,} parameters" for name, count in counts.items()),
    ]


def _training(found: object) -> list[str]:
    """How the avatar was trained, a line a fact: values as they stand, of an object each entry."""
    if not isinstance(found, dict):
        return []
    lines = []
    for name, value in found.items():
        if isinstance(value, dict):
            lines += [f"  training: {name}: {key}: {_short(each)}" for key, each in value.items()]
        else:
            lines.append(f"  training: {name}: {_short(value)}")
    return lines


def _short(value: object) -> str:
    """A text as it is, all else as JSON, of at most `WIDTH` characters."""
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= WIDTH else text[: WIDTH - 1] + "…"


def _motion(file: Path) -> list[str]:
    motion = Motion.read(file)
    sequence = motion.sequence
    return [
        f"{file}: a motion of {len(motion)} frames at {sequence.fps:g} frames a second ({sequence.duration:.2f} s)",
        "  drives: " + (", ".join(motion.driven) or "nothing"),
        *(f"  {note}" for note in sequence.notes),
    ]


def _session(file: Path) -> list[str]:
    journal = Journal.load(file)
    state = journal.state
    return [
        f"{file}: a session of {len(journal.steps)} steps",
        f"  avatar: {state.avatar}",
        *([f"  motion: {state.motion.path}, frame {state.motion.frame}"] if state.motion else []),
    ]


def _picture(file: Path) -> list[str]:
    """What the studio wrote into a picture: the state that it shows."""
    from avatarrex.files.images import read_png_text  # torch: a wrong file is refused without it

    (width, height), text = read_png_text(file, "avatarrex")
    lines = [f"{file}: a picture of {width}x{height} pixels"]
    if text is None:
        return [*lines, "  not rendered by the studio: no text 'avatarrex'"]
    state = StudioState.from_json(parse_json(text, file, "avatarrex"), f"{file}: avatarrex")
    moved = [name for name, value in vars(state.signals).items() if np.any(value)]
    view = state.view
    return [
        *lines,
        f"  avatar: {state.avatar}",
        f"  level: {state.level}",
        f"  camera: azimuth {view.azimuth:g}, elevation {view.elevation:g}, {view.distance:g} m, {view.fov:g} degrees",
        *([f"  motion: {state.motion.path}, frame {state.motion.frame}"] if state.motion else []),
        "  not at rest: " + (", ".join(moved) or "nothing"),
    ]


def _is_session(file: Path) -> bool:
    data = read_json(file)
    return isinstance(data, dict) and data.get("kind") == "session"
