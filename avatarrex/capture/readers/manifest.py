"""`capture.json`: what a capture keeps from training, where it comes from, whether it is complete.

{"format": 1, "held_out_frames": {rig: [frame]}, "held_out_cameras": {rig: [name]}, "validation_frames": {rig: [frame]},
"provenance": {…}, "complete": true}; what is held out is for tests alone, what is validation's is read by splits.py. The provenance of a
few frames alone has `preview`, how many were wanted.
"""

from __future__ import annotations

from typing import Any

from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.layout import RigFiles
from avatarrex.errors import InputError

FORMAT = 1
"""Version of the file; a newer one is refused by name."""


def read_manifest(archive: Archive, root: str, rigs: dict[str, RigFiles]) -> dict[str, Any]:
    """`capture.json`, or nothing."""
    name = f"{root}/capture.json".lstrip("/")
    if not archive.exists(name):
        return {}
    place = archive.place(name)
    manifest = archive.json(name)
    if not isinstance(manifest, dict) or type(manifest.get("format")) is not int:
        raise InputError(place, "format", "an object with an integer format", repr(manifest)[:60])
    if manifest["format"] > FORMAT:
        raise InputError(place, "format", f"at most {FORMAT} (update the studio)", manifest["format"])
    if not isinstance(manifest.get("provenance", {}), dict):
        raise InputError(place, "provenance", "an object", repr(manifest["provenance"])[:60])
    for key in ("held_out_frames", "held_out_cameras"):
        listed = manifest.get(key, {})
        if not isinstance(listed, dict) or not all(isinstance(listed[rig], list) for rig in listed):
            raise InputError(place, key, "an object with a list per rig", repr(listed)[:60])
        for rig in listed:
            if rig not in rigs:
                raise InputError(place, key, "rigs of the capture: " + ", ".join(rigs), rig)
    return manifest


def warnings(manifest: dict[str, Any]) -> list[str]:
    """That the capture is not the whole, one sentence each."""
    found = []
    if manifest.get("complete") is False:
        found.append("capture.json: the capture is not complete")
    if "preview" in manifest.get("provenance", {}):
        found.append(
            "capture.json: a preview, a few frames alone, renumbered: `capture import` without --preview writes all"
        )
    return found


def held_out(
    manifest: dict[str, Any], rig: str, count: int, cameras: tuple[str, ...], place: str
) -> tuple[list[int], list[int]]:
    """Frames and views of a rig of `count` listed that no training may see. Raises `InputError` for those it has not."""
    listed = manifest.get("held_out_frames", {}).get(rig, [])
    names = manifest.get("held_out_cameras", {}).get(rig, [])
    for frame in listed:
        if type(frame) is not int or not 0 <= frame < count:
            raise InputError(place, f"held_out_frames.{rig}", f"integers from 0 to {count - 1}", frame)
    for name in names:
        if name not in cameras:
            raise InputError(place, f"held_out_cameras.{rig}", "one of " + ", ".join(cameras), name)
    return listed, [cameras.index(name) for name in names]
