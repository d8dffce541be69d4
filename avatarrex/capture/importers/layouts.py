"""The layouts that captures of this field have, in one table: what a folder is known by, and what reads it (docs/import.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from avatarrex.capture.importers.actorshq import read_actorshq
from avatarrex.capture.importers.faces import read_imavatar, read_nerface
from avatarrex.capture.importers.multiview import read_multiview
from avatarrex.capture.importers.source import Reading, Source
from avatarrex.capture.importers.zju import read_zju
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.layout import RIGS
from avatarrex.errors import InputError
from avatarrex.templates.person import load_person


@dataclass(frozen=True)
class Layout:
    """One layout."""

    name: str
    marks: tuple[str, ...]
    """Files and folders that all have to be there."""
    read: Callable[[Reading], Source]


LAYOUTS = (
    Layout("AvatarReX", ("calibration_full.json",), read_multiview),
    Layout("THuman4.0", ("calibration.json", "images", "masks"), read_multiview),
    Layout("ZJU-MoCap", ("annots.npy",), read_zju),
    Layout("ActorsHQ", ("calibration.csv", "rgbs"), read_actorshq),
    Layout("IMAvatar", ("flame_params.json",), read_imavatar),
    Layout("NeRFace", ("transforms_train.json",), read_nerface),
)


def find_layout(archive: Archive) -> tuple[Layout, str]:
    """The layout of a capture and the folder that holds it; a single folder that holds everything is entered. Raises `InputError`."""
    root, top = "", archive.entries()
    while True:
        entries = archive.entries(root)
        found = next((layout for layout in LAYOUTS if set(layout.marks) <= entries), None)
        if found is not None:
            return found, root
        if any("calibration_full.json" in archive.entries(f"{root}/{rig}".lstrip("/")) for rig in RIGS):
            raise InputError(
                archive.path,
                "",
                "a capture of another layout",
                "one that is in ours: `capture check` reads it as it is",
            )
        inner = [entry for entry in entries if not entry.startswith((".", "__MACOSX"))]
        below = f"{root}/{inner[0]}".lstrip("/") if len(inner) == 1 else ""
        if not below or not archive.entries(below):
            expected = "; ".join(f"{' with '.join(layout.marks)} ({layout.name})" for layout in LAYOUTS)
            raise InputError(archive.path, "", f"one of {expected}", ", ".join(sorted(top)[:8]) or "an empty folder")
        root = below


def read_source(archive: Archive, unit: float = 1.0) -> tuple[Source, Reading]:
    """What an archive of a known layout holds, and what was noted while reading; `unit` as `Reading` has it. Raises `InputError`."""
    layout, root = find_layout(archive)
    reading = Reading(archive, root, load_person(), unit)
    return layout.read(reading), reading
