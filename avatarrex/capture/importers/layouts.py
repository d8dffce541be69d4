"""What reads a capture of each layout of `marks.py`."""

from __future__ import annotations

from collections.abc import Callable

from avatarrex.capture.importers.actorshq import read_actorshq
from avatarrex.capture.importers.faces import read_imavatar, read_nerface
from avatarrex.capture.importers.marks import MARKS, marked
from avatarrex.capture.importers.multiview import read_multiview
from avatarrex.capture.importers.source import Reading, Source
from avatarrex.capture.importers.zju import read_zju
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.layout import find_rigs
from avatarrex.errors import InputError
from avatarrex.templates.person import load_person

READERS: dict[str, Callable[[Reading], Source]] = {
    "AvatarReX": read_multiview,
    "THuman4.0": read_multiview,
    "ZJU-MoCap": read_zju,
    "ActorsHQ": read_actorshq,
    "IMAvatar": read_imavatar,
    "NeRFace": read_nerface,
}


def read_source(archive: Archive, unit: float | None = None) -> tuple[Source, Reading]:
    """What an archive of a known layout holds, and what was noted while reading; `unit` as `Reading` has it. Raises `InputError`."""
    found = marked(archive)
    if found is None:
        raise _unknown(archive)
    layout, root = found
    reading = Reading(archive, root, load_person(), unit)
    return READERS[layout](reading), reading


def _unknown(archive: Archive) -> InputError:
    """Why an archive is not one to import."""
    try:
        find_rigs(archive)
    except InputError:
        known = "; ".join(f"{' with '.join(marks)} ({name})" for name, marks in MARKS.items())
        there = ", ".join(sorted(archive.entries())[:8]) or "an empty folder"
        return InputError(archive.path, "", f"one of {known}", there)
    found = "one that is in ours: `capture check` reads it as it is"
    return InputError(archive.path, "", "a capture of another layout", found)
