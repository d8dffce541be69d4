"""An avatar's surface from its fields: mesh, observed poses, texture, expressions, corrections; goes on where it was stopped.

Each observed pose is a file in a work folder, written whole, so that a killed distillation loses one pose. The folder is of one
avatar's weights and one set of options; another one is begun anew.

Letters: n poses, v vertices, e expressions, m vertices that an expression moves, x texels. Metres at rest; colours sRGB-encoded.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.distil.atlas import SIDE, Atlas, make_atlas
from avatarrex.distil.bake import Bake
from avatarrex.distil.fit import Residuals, fit_correction
from avatarrex.distil.observe import Observation, Observer
from avatarrex.distil.poses import fitting_poses, single_expressions
from avatarrex.distil.rest_mesh import rest_mesh
from avatarrex.distil.texels import Texels, texels
from avatarrex.files.gate import written
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.surface.surface import Surface
from avatarrex.surface.surface_file import weights_key

POSES = 240
"""Observed poses: errors fall by 4 % from 160 to 240 (docs/surface.md)."""
BAKED = ("stand", "apose", "walk", "wave")
"""Poses whose colours the texture is the mean of."""
MOVED = 1e-4
"""Metres by which an expression has to move a vertex to be stored."""
TINTED = 4 / 255
Progress = Callable[[str, int, int], None]
"""Called with what is done, how many steps of it, of how many."""


@dataclass(frozen=True)
class Expressions:
    """What each expression alone does."""

    vertex: np.ndarray
    shift: np.ndarray
    """(e, m, 3)."""
    colour: np.ndarray
    """(e, m, 3)."""


def distil(avatar: Avatar, work: Path | None = None, poses: int = POSES, progress: Progress | None = None) -> Surface:
    """The surface of `avatar`. With `work`, a folder, a stopped distillation goes on there; it is removed at the end."""
    if work is None:
        with TemporaryDirectory() as folder:
            return distil(avatar, Path(folder) / "work", poses, progress)
    begun = time.monotonic()
    tell = progress or (lambda what, done, of: None)
    key = weights_key(avatar)
    _claim(work, f"{key} {poses}")
    tell("mesh", 0, 1)
    mesh = rest_mesh(avatar)
    observer = Observer(avatar, mesh)
    signals = fitting_poses(poses)
    seen = _observed(observer, signals, work, "pose", tell)
    expressions = _expressions(observer, work, tell)
    atlas = make_atlas(mesh.vertices, mesh.faces, mesh.part)
    places = texels(atlas.uv, atlas.uv_faces, SIDE, SIDE)
    albedo, at_vertices = _baked(observer, places, tell)
    tell("corrections", 0, 1)
    value = np.stack([np.concatenate([one.shift, one.albedo - at_vertices], 1) for one in seen])
    residuals = Residuals(signals, value, np.stack([one.found for one in seen]))
    mean, correction = fit_correction(residuals, mesh.joint[:, 0].astype(int), avatar.person.body.parents)
    albedo = albedo + places.interpolated(mesh.faces, mean[:, 3:])
    scale = float(np.quantile(albedo, 0.9999))
    image = places.image(np.clip(np.rint(255 * albedo / scale), 0, 255).astype(np.uint8))
    meta = {"seconds": round(time.monotonic() - begun, 1), "poses": poses}
    surface = _assembled(mesh, mean, atlas, image, scale, observer, expressions, correction, key, meta)
    shutil.rmtree(work)
    return surface


def _assembled(mesh, mean, atlas: Atlas, image, scale, observer, expressions, correction, key, meta) -> Surface:  # type: ignore[no-untyped-def]
    return Surface(
        vertices=(mesh.vertices + mean[:, :3]).astype(np.float32),
        faces=mesh.faces,
        joint=mesh.joint,
        weight=mesh.weight,
        template_face=mesh.template_face,
        barycentric=mesh.barycentric,
        part=mesh.part,
        uv=atlas.uv,
        uv_vertex=atlas.uv_vertex,
        uv_faces=atlas.uv_faces,
        albedo=image,
        albedo_scale=scale,
        lit=observer.lit.numpy().astype(np.float32),
        morph_vertex=expressions.vertex.astype(np.int32),
        morph=expressions.shift.astype(np.float32),
        morph_colour=expressions.colour.astype(np.float32),
        correction=correction,
        key=key,
        meta=meta,
    )


def _claim(work: Path, owner: str) -> None:
    """Make the work folder this distillation's own: what another one left in it is removed."""
    note = work / "of.txt"
    if work.exists() and (not note.is_file() or note.read_text() != owner):
        shutil.rmtree(work)
    work.mkdir(parents=True, exist_ok=True)
    with written(note) as temporary:
        temporary.write_text(owner)


def _observed(observer: Observer, signals: list[Signals], work: Path, name: str, tell: Progress) -> list[Observation]:
    """Every pose, from the work folder where it is there."""
    seen = []
    for number, one in enumerate(signals):
        tell(f"{name}s", number, len(signals))
        file = work / f"{name}_{number:03}.npz"
        if not file.is_file():
            found = observer.observe(one)
            with written(file) as temporary, open(temporary, "wb") as out:
                np.savez(out, guess=found.guess, shift=found.shift, albedo=found.albedo, found=found.found)
        with np.load(file) as arrays:
            seen.append(Observation(**arrays))
    return seen


def _expressions(observer: Observer, work: Path, tell: Progress) -> Expressions:
    neutral = observer.neutral
    assert neutral is not None
    seen = _observed(observer, single_expressions(), work, "expression", tell)
    shift = np.stack([one.shift - neutral.shift for one in seen])
    colour = np.stack([observer.tinted(one) for one in seen])
    moved = (np.abs(shift).max((0, 2)) > MOVED) | (np.abs(colour).max((0, 2)) > TINTED)
    vertex = np.flatnonzero(moved)
    return Expressions(vertex, shift[:, vertex], colour[:, vertex])


def _baked(observer: Observer, places: Texels, tell: Progress) -> tuple[np.ndarray, np.ndarray]:
    """Albedo of the texels (x, 3), and of the vertices (v, 3) in the same poses."""
    bake, at_vertices = Bake(places, observer.mesh.faces), []
    for number, name in enumerate(BAKED):
        tell("texture", number, len(BAKED))
        exact, followed = observer.follow(Signals.rest().replace(body_pose=named_pose(name)))
        light = observer.light(followed)
        bake.add(exact, followed, light.numpy())
        at_vertices.append((exact.colour(followed.position, -followed.normal) / light).numpy())
    return bake.albedo(), np.mean(at_vertices, 0)
