"""The file that an export goes to: what its ending means, judged before any work. Needs no torch."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable

BONES = {".glb": 8, ".vrm": 4, ".html": 4, ".usdz": 8, ".usdc": 8}
"""Joints of a vertex by format; three.js and VRM read four."""
MESHES = (".obj", ".ply")
ENDINGS = (*BONES, *MESHES)


def check_export(path: str | Path, clips: int = 0, frames: int = 1) -> Path:
    """The path, where it can be written with so many clips, the first of which has so many frames. Raises `InputError`."""
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(path, "", "a file that ends in " + ", ".join(ENDINGS), path.suffix or "no extension")
    if ending == ".vrm" and clips:
        raise InputError(path, "", "no motion and no pose for a .vrm, which has no clips (a .glb has)", clips)
    if ending in MESHES and clips > 1:
        raise InputError(path, "", f"one motion or pose for {ending}", clips)
    frames = frames if ending in MESHES else 1
    for target in files_of(path, frames):
        check_writable(target)
    if not numbered(path, frames)[0].exists():  # no export that is made anew: what lies there is somebody else's
        for target in _beside(path):
            if target.exists():
                raise InputError(target, "", f"nothing there: it is written beside {path.name}", "a file")
    if ending in (".usdz", ".usdc") and find_spec("pxr") is None:
        raise InputError(path, "", "usd-core for USD (pip install 'avatarrex-studio[usd]')", "it is not installed")
    return path


def files_of(path: Path, frames: int) -> list[Path]:
    """Every file that is written, in the order in which they appear."""
    return [*_beside(path), *numbered(path, frames)]


def numbered(path: Path, frames: int) -> list[Path]:
    """`OUT.obj`, or `OUT_0001.obj` … where there are several frames."""
    if frames == 1:
        return [path]
    digits = max(4, len(str(frames)))
    return [path.with_name(f"{path.stem}_{k:0{digits}d}{path.suffix}") for k in range(1, frames + 1)]


def _beside(path: Path) -> list[Path]:
    """Texture and material."""
    suffixes = {".obj": (".png", ".mtl"), ".usdc": (".jpg",)}.get(path.suffix.lower(), ())
    return [path.with_suffix(suffix) for suffix in suffixes]
