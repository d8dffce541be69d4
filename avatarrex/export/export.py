"""An avatar's surface as a file for other programs, by the file's ending.

    .glb            skeleton, skin of eight joints a vertex, 52 morph targets, texture, clips
    .vrm            VRM 1.0: four joints, humanoid bones, expressions, terms of use; no clips
    .usdz .usdc     UsdSkel: eight joints, blend shapes, texture, clips (extra `usd`)
    .html           a page that shows it in any browser: four joints, morph targets, clips
    .obj .ply       posed meshes: one, or a numbered sequence of a clip

A path that cannot be written, an ending that is none, clips that a format has no place for, and USD without its package are
refused before any work; files appear whole, and all or none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from avatarrex.avatar import Avatar
from avatarrex.errors import InputError
from avatarrex.export.clips import Clip
from avatarrex.export.glb import glb_document, jpeg
from avatarrex.export.label import Label
from avatarrex.export.losses import Source, animated_losses, frames_of, still_losses
from avatarrex.export.mesh_files import write_meshes
from avatarrex.export.rig import rig_of
from avatarrex.export.target import BONES, MESHES, check_export
from avatarrex.export.usd import write_usd
from avatarrex.export.vrm import vrm_document
from avatarrex.export.web import page
from avatarrex.files.gate import written
from avatarrex.signals.driving import Signals


@dataclass(frozen=True)
class Exported:
    """The files, and what is said of them."""

    files: tuple[Path, ...]
    label: Label


def export_avatar(avatar: Avatar, path: str | Path, clips: Sequence[Clip] = ()) -> Exported:
    """Write the avatar's surface to `path`, with clips (`read_clips`) where the format has them. Raises `InputError`."""
    path = check_export(path, len(clips), len(clips[0]) if clips else 1)
    label = Label.of(avatar.meta)
    if avatar.surface is None:
        raise InputError(label.name, "surface", "an avatar with a surface (avatarrex-studio distil makes it)", "none")
    source = Source(avatar.surface, avatar.person, avatar.light)
    ending = path.suffix.lower()
    if ending in MESHES:
        frames = list(clips[0].sequence) if clips else [Signals.rest()]
        label = replace(label, losses=still_losses(source, ending == ".obj", len(frames)))
        return Exported(tuple(write_meshes(source, path, frames, label)), label)
    light = source.mean_factor(frames_of(clips))
    rig = rig_of(source.surface, avatar.person, light).limited(BONES[ending])
    label = replace(label, losses=animated_losses(source, rig, clips, jpeg(rig.texture)))
    if ending in (".usdz", ".usdc"):
        return Exported(tuple(write_usd(rig, clips, label, path)), label)
    document = vrm_document(rig, label) if ending == ".vrm" else glb_document(rig, clips, label)
    content = document.bytes()
    with written(path) as temporary:
        temporary.write_bytes(page(content, label).encode() if ending == ".html" else content)
    return Exported((path,), label)
