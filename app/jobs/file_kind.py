"""What a path is: an avatar, a motion, a capture, a run, a session or a picture; or a capture of another layout, to be imported.

One judgement for the window's *Open*, for what is dropped on it, for the command line and for `inspect`. It looks at names and, of a
JSON file, at its `kind`; whether a file is whole is found by its reader. Needs no torch.
"""

from __future__ import annotations

import os
import shlex
import zipfile
from pathlib import Path

from avatarrex_studio.jobs.runs import run_folders

from avatarrex.capture.importers.marks import marked
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.layout import find_rigs
from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import read_json
from avatarrex.signals.own_motions import MOTIONS
from avatarrex.signals.read import READERS

AVATAR, MOTION, CAPTURE, RUN, SESSION, PICTURE = "avatar", "motion", "capture", "run", "session", "picture"
FOREIGN = "capture of another layout"
OPENS = "an avatar, a motion, a capture, a run or a session"
EXPECTED = f"{OPENS}, or a picture"
NAMES = 6
"""Entries of a folder that an error names."""


def kind_of(path: str | Path) -> str:
    """One of the seven kinds; `default` and motions of the program count by their names. Raises `InputError`."""
    name = str(path)
    if name == "default":
        return AVATAR
    if name in MOTIONS:
        return MOTION
    found = what_is(path)
    if found not in ("a file", "a folder"):
        raise InputError(path, "", EXPECTED, found)
    return _of_folder(Path(path)) if found == "a folder" else _of_file(Path(path))


def runs_in(folder: Path) -> list[Path]:
    """The run that `folder` is, or those that lie in it or one folder below."""
    return sorted(run_folders(folder, 1))


def how_to_import(path: str | Path) -> str:
    """What a capture of another layout is, and what writes it in ours: in the window and as a command."""
    found = marked(Archive(Path(path)))
    layout = "another layout" if found is None else f"the layout of {found[0]}"
    command = f"avatarrex-studio capture import {shlex.quote(str(path))} OUT"
    return f"a capture in {layout}: File → Import a capture…, or `{command}`, writes it in ours"


def _of_folder(folder: Path) -> str:
    if runs_in(folder):
        return RUN
    if what_is(folder / "avatar.json") == "a file":
        return AVATAR
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise InputError(folder, "", EXPECTED, error.strerror or error) from None
    try:
        return _of_archive(Archive(folder))
    except InputError:
        more = ", …" if len(names) > NAMES else ""
        found = f"a folder with {', '.join(names[:NAMES])}{more}" if names else "an empty folder"
        raise InputError(folder, "", EXPECTED, found) from None


def _of_archive(archive: Archive) -> str:
    """A capture, ours or another's. Raises `InputError`."""
    try:
        find_rigs(archive)
    except InputError:
        if marked(archive) is None:
            raise
        return FOREIGN
    return CAPTURE


def _of_file(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix == ".json":
        data = read_json(file)
        return SESSION if isinstance(data, dict) and data.get("kind") == SESSION else MOTION
    if suffix in READERS:
        return MOTION
    if suffix in (".avatar", ".png", ".jpg", ".jpeg"):
        return AVATAR if suffix == ".avatar" else PICTURE
    if not zipfile.is_zipfile(file):
        raise InputError(file, "", EXPECTED, "another kind of file")
    return _of_archive(Archive(file))
