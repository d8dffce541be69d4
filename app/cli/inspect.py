"""`avatarrex-studio inspect PATH`: what a file is, an avatar, a motion or a session, said in a few lines."""

from __future__ import annotations

import argparse
from pathlib import Path

from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion

from avatarrex.errors import InputError, plain
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import read_json
from avatarrex.signals.own_motions import MOTIONS


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
        raise InputError(path, "", "an avatar, a motion or a session", found)
    if path == "default" or found == "a folder" or file.suffix == ".avatar":
        return _avatar(path)
    if file.suffix == ".json" and _is_session(file):
        return _session(file)
    return _motion(file)


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
        "  surface: " + (f"{len(avatar.surface.faces):,} triangles" if avatar.surface else "none"),
        *(f"  {name} field: {count:,} parameters" for name, count in counts.items()),
    ]


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


def _is_session(file: Path) -> bool:
    data = read_json(file)
    return isinstance(data, dict) and data.get("kind") == "session"
