"""Where a capture keeps its files: one `RigFiles` per rig, detected by the calibration file (docs/capture.md).

AvatarReX: `<camera>/%08d.jpg`, `<camera>/mask/pha/%08d.jpg`, `calibration_full.json`. THuman4.0: `images/<camera>/…`,
`masks/<camera>/…`, `calibration.json`. Ours is one folder `body/` and one `face/` in the AvatarReX layout, and
`capture.json`. Pictures are JPEG or PNG; a frame is the number in its name.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from avatarrex.capture.readers.archive import Archive
from avatarrex.errors import InputError

RIGS = ("body", "face")
CALIBRATIONS = {"calibration_full.json": "AvatarReX", "calibration.json": "THuman4.0"}
KNOWN = (
    "calibration_full.json (AvatarReX) in the folder, or in its body/ and face/; or calibration.json with images/ and "
    "masks/ (THuman4.0)"
)
_PICTURE = re.compile(r"(\d{1,9})\.(?:jpg|jpeg|png)", re.IGNORECASE)


@dataclass(frozen=True)
class RigFiles:
    """The files of one rig."""

    archive: Archive
    folder: str
    """Where the rig's files lie, "" for the root."""
    kind: str
    """`AvatarReX` or `THuman4.0`."""

    def name(self, *parts: str) -> str:
        """A file of this rig."""
        return "/".join(part for part in (self.folder, *parts) if part)

    @property
    def calibration(self) -> str:
        """The calibration file."""
        return self.name(next(name for name, kind in CALIBRATIONS.items() if kind == self.kind))

    @property
    def parameters(self) -> str:
        """The SMPL-X parameters."""
        return self.name("smpl_params.npz")

    @property
    def ground_truth(self) -> str | None:
        """Exact meshes, where the capture has them."""
        name = self.name("ground_truth.npz")
        return name if self.archive.exists(name) else None

    def pictures(self, camera: str) -> dict[int, str]:
        """Images of a camera by frame number."""
        return self._numbered(self.name(camera) if self.kind == "AvatarReX" else self.name("images", camera))

    def mattes(self, camera: str) -> dict[int, str]:
        """Mattes of a camera by frame number."""
        avatarrex = self.kind == "AvatarReX"
        return self._numbered(self.name(camera, "mask", "pha") if avatarrex else self.name("masks", camera))

    def listed_missing(self, cameras: tuple[str, ...]) -> frozenset[tuple[int, int]]:
        """(view, frame) of every line of `missing_img_files.txt`: `…/<camera>/%08d.jpg`, either kind of slash."""
        name = self.name("missing_img_files.txt")
        if not self.archive.exists(name):
            return frozenset()
        views = {camera: view for view, camera in enumerate(cameras)}
        found = set()
        for number, line in enumerate(self.archive.text(name).splitlines(), 1):
            parts = line.strip().replace("\\", "/").split("/")
            if parts == [""]:
                continue
            match = _PICTURE.fullmatch(parts[-1])
            # `<camera>/mask/pha/x.jpg` names the camera third from the end
            view = next((views[part] for part in reversed(parts[:-1]) if part in views), None)
            if match is None or len(parts) < 2:
                raise InputError(self.archive.place(name), f"line {number}", "CAMERA/00000000.jpg", line.strip()[:80])
            if view is not None:  # lines about cameras that were not calibrated, or not downloaded
                found.add((view, int(match[1])))
        return frozenset(found)

    def _numbered(self, folder: str) -> dict[int, str]:
        matches = (_PICTURE.fullmatch(entry) for entry in sorted(self.archive.entries(folder)))
        return {int(match[1]): f"{folder}/{match[0]}" for match in matches if match}


def find_rigs(archive: Archive) -> tuple[str, dict[str, RigFiles]]:
    """The folder that holds the capture, and its rigs by name. Raises `InputError` naming what was looked for.

    A single folder that holds everything (a zip of a folder) is entered.
    """
    root, top = "", archive.entries()
    while not _rigs(archive, root):
        inner = [entry for entry in archive.entries(root) if not entry.startswith((".", "__MACOSX"))]
        below = f"{root}/{inner[0]}".lstrip("/") if len(inner) == 1 else ""
        if not below or not archive.entries(below):
            found = ", ".join(sorted(top)[:8]) or "an empty folder"
            raise InputError(archive.path, "", KNOWN, found + (", …" if len(top) > 8 else ""))
        root = below
    return root, _rigs(archive, root)


def _rigs(archive: Archive, root: str) -> dict[str, RigFiles]:
    """Rigs with a calibration at `root`: its `body` and `face`, else itself as `body`."""

    def kind(folder: str) -> str | None:
        entries = archive.entries(folder)
        for name, kind in CALIBRATIONS.items():
            if name in entries and (kind == "AvatarReX" or "images" in entries):
                return kind
        return None

    folders = {rig: f"{root}/{rig}".lstrip("/") for rig in RIGS}
    rigs = {rig: RigFiles(archive, folder, found) for rig, folder in folders.items() if (found := kind(folder))}
    if rigs:
        return rigs
    found = kind(root)
    return {"body": RigFiles(archive, root, found)} if found else {}
