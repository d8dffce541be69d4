"""What a capture of each layout of this field is known by, in one table (docs/import.md). Needs no torch."""

from __future__ import annotations

from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.layout import RIGS

MARKS = {
    "AvatarReX": ("calibration_full.json",),
    "THuman4.0": ("calibration.json", "images", "masks"),
    "ZJU-MoCap": ("annots.npy",),
    "ActorsHQ": ("calibration.csv", "rgbs"),
    "IMAvatar": ("flame_params.json",),
    "NeRFace": ("transforms_train.json",),
}
"""By name, files and folders that all have to be there."""


def marked(archive: Archive) -> tuple[str, str] | None:
    """The name of a capture's layout, and the folder that holds it; None for an unknown one, and for ours.

    A single folder that holds everything is entered.
    """
    root = ""
    while True:
        entries = archive.entries(root)
        if any(MARKS["AvatarReX"][0] in archive.entries(f"{root}/{rig}".lstrip("/")) for rig in RIGS):
            return None
        found = next((name for name, marks in MARKS.items() if set(marks) <= entries), None)
        if found is not None:
            return found, root
        inner = [entry for entry in entries if not entry.startswith((".", "__MACOSX"))]
        if len(inner) != 1 or not archive.entries(f"{root}/{inner[0]}".lstrip("/")):
            return None
        root = f"{root}/{inner[0]}".lstrip("/")
