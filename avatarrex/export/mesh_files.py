"""Posed meshes by trimesh: OBJ with material and texture, PLY with vertex colours; one, or a numbered sequence.

The vertices are the whole surface's, corrections included, with the root's turn and place, feet on y = 0. A single OBJ has the light
of its pose in its texture; a sequence shares one texture, with the mean light of its frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from avatarrex.export.label import Label
from avatarrex.export.losses import Source, some_of
from avatarrex.export.target import files_of, numbered
from avatarrex.export.texture import baked_texture
from avatarrex.files.gate import written
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose import PosedSurface


def write_meshes(source: Source, path: Path, frames: list[Signals], label: Label) -> list[Path]:
    """Write the frames; all files or none. Raises `InputError`."""
    paths = files_of(path, len(frames))
    with ExitStack() as stack:
        targets = {target: stack.enter_context(written(target)) for target in paths}
        write = _write_obj if path.suffix.lower() == ".obj" else _write_ply
        for target, signals in zip(numbered(path, len(frames)), frames):
            targets[target].write_bytes(write(source, source.posed(signals), signals, path.stem, label))
        if path.suffix.lower() == ".obj":
            _write_material(source, frames, targets, path)
    return paths


def _write_obj(source: Source, posed: PosedSurface, signals: Signals, name: str, label: Label) -> bytes:
    surface, vertices = source.surface, source.world(posed, signals)
    material = trimesh.visual.material.SimpleMaterial(image=Image.new("RGB", (1, 1)), name=name)
    visual = trimesh.visual.TextureVisuals(uv=surface.uv * [1, -1] + [0, 1], material=material)
    mesh = trimesh.Trimesh(
        vertices[surface.uv_vertex], surface.uv_faces, visual=visual, process=False,
        vertex_normals=posed.normals[surface.uv_vertex],
    )  # fmt: skip
    header = "\n# ".join(_comment(label))
    text, _ = trimesh.exchange.obj.export_obj(mesh, return_texture=True, mtl_name=f"{name}.mtl", header=header)
    return str(text).encode()


def _write_material(source: Source, frames: list[Signals], targets: dict[Path, Path], path: Path) -> None:
    """The texture, and a material that shows it as it is."""
    tint = source.posed(frames[0]).tint if len(frames) == 1 else None
    texture = baked_texture(source.surface, source.mean_factor(some_of(frames)), tint)
    Image.fromarray(texture).save(targets[path.with_suffix(".png")], "PNG")
    lines = [f"newmtl {path.stem}", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 0", f"map_Kd {path.stem}.png"]
    targets[path.with_suffix(".mtl")].write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_ply(source: Source, posed: PosedSurface, signals: Signals, name: str, label: Label) -> bytes:
    colours = np.rint(255 * source.colours(posed, signals)).astype(np.uint8)
    mesh = trimesh.Trimesh(
        source.world(posed, signals),
        source.surface.faces,
        process=False,
        vertex_colors=colours,
        vertex_normals=posed.normals,
    )
    content = trimesh.exchange.ply.export_ply(mesh, vertex_normal=True)
    comments = "".join(f"comment {line}\n" for line in [name, *_comment(label)])
    return bytes(content.replace(b"end_header\n", comments.encode("ascii", "replace") + b"end_header\n", 1))


def _comment(label: Label) -> Iterator[str]:
    yield "AvatarReX Studio"
    for line in label.lines():
        yield line.replace("\n", " ")
