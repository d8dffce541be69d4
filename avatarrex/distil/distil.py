"""An avatar's surface from its fields: mesh, observed poses, texture, expressions, corrections; goes on where it was stopped.

Each observed pose is a file in a work folder, written whole, so that a killed distillation loses one pose. The folder is of one
avatar's weights and one set of options; another one is begun anew.

Letters: n poses, v vertices, e expressions, m vertices that an expression moves, x texels. Metres at rest; colours sRGB-encoded.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from scipy.spatial import cKDTree

from avatarrex.avatar import Avatar
from avatarrex.distil.atlas import SIDE, make_atlas
from avatarrex.distil.bake import Bake
from avatarrex.distil.errors import surface_errors
from avatarrex.distil.fit import fit_correction
from avatarrex.distil.hidden import shown
from avatarrex.distil.observe import Observation, Observer
from avatarrex.distil.poses import fitting_poses, single_expressions
from avatarrex.distil.rest_mesh import rest_mesh
from avatarrex.distil.texels import Texels, texels
from avatarrex.errors import InputError
from avatarrex.files.gate import written
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_pose
from avatarrex.surface.surface import Surface
from avatarrex.surface.surface_file import weights_key
from avatarrex.templates.parts import PARTS

FORMAT = 4
"""Of the observed poses: those of another one are not gone on with."""
POSES = 160
"""Observed poses: with 240 the errors are the same (ROADMAP.md)."""
BAKED = 8
"""Fitted poses whose colours the texture of body and hands takes in the mean, beside the standing one's: 160 are 0.1 dB better."""
HIDDEN = 1e-5
"""Weight of poses with a closed mouth inside of it."""
PARTED = 0.02
"""Weight of the open mouth on the lips: it decides where a closed one hides what they touch (`bake.FAINT`). Nowhere else: a face's rim that
no pose finds on the surface had the colours of an open jaw."""
PARTING = 0.45
"""Of the open jaw, for the colours within: wider ones are rarer in captures, and the field says less of them."""
MOVED = 1e-4
"""Metres by which an expression has to move a vertex to be stored."""
TINTED = 4 / 255
"""Change of albedo likewise."""
BRIGHTEST = 0.9999
"""Share of the texels' values that the texture's bytes reach."""
OF_MESH = ("faces", "joint", "weight", "template_face", "barycentric", "part")
"""What the surface takes from its mesh as it is."""
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
    """The surface of `avatar`. With `work`, a folder, a stopped distillation goes on there; remove it once the surface is stored.

    Raises `InputError` for a folder of other files.
    """
    if work is None:
        with TemporaryDirectory() as folder:
            return distil(avatar, Path(folder) / "work", poses, progress)
    begun = time.monotonic()
    tell = progress or (lambda what, done, of: None)
    key = weights_key(avatar)
    claim(work, f"{key} {poses} {FORMAT}")
    tell("mesh", 0, 1)
    observer = Observer(avatar, rest_mesh(avatar))
    signals = fitting_poses(poses)
    seen = observed(observer, signals, work, "pose", tell)
    faces = observed(observer, single_expressions(), work, "expression", tell)
    surface = replace(_textured(observer, signals, seen, faces, tell), key=key)
    tell("errors", 0, 1)
    errors = surface_errors(avatar, surface)
    about = {"seconds": round(time.monotonic() - begun, 1), "poses": poses, "triangles": len(surface.faces)}
    return replace(surface, meta={**about, **errors})


def _textured(
    observer: Observer, signals: list[Signals], seen: list[Observation], faces: list[Observation], tell: Progress
) -> Surface:
    """Atlas, albedo and corrections; without key and errors."""
    mesh = observer.mesh
    atlas = make_atlas(mesh.vertices, mesh.faces, mesh.part)
    places = texels(atlas.uv, atlas.uv_faces, SIDE, SIDE)
    albedo, at_vertices = _baked(observer, signals[:BAKED], places, tell)
    tell("corrections", 0, 1)
    expressions = _expressions(observer, faces)
    residuals = observer.residuals(signals, seen, at_vertices)
    parents = observer.avatar.person.body.parents
    mean, correction = fit_correction(residuals, mesh.joint[:, 0].astype(int), parents)
    albedo = albedo + places.interpolated(mesh.faces, mean[:, 3:])
    scale = float(np.quantile(albedo, BRIGHTEST))
    return Surface(
        **{name: getattr(mesh, name) for name in OF_MESH},
        **vars(atlas),
        vertices=(mesh.vertices + mean[:, :3]).astype(np.float32),
        albedo=places.image(np.clip(np.rint(255 * albedo / scale), 0, 255).astype(np.uint8)),
        albedo_scale=scale,
        lit=observer.lit.numpy().astype(np.float32),
        morph_vertex=expressions.vertex.astype(np.int32),
        morph=expressions.shift.astype(np.float32),
        morph_colour=expressions.colour.astype(np.float32),
        correction=correction,
    )


def claim(work: Path, owner: str) -> None:
    """Make the work folder this distillation's own: what another one left in it is removed. Raises `InputError` for other files."""
    note = work / "of.txt"
    if work.exists() and not work.is_dir():
        raise InputError(work, "", "a folder", "a file")
    work.mkdir(parents=True, exist_ok=True)
    own = [path for path in work.iterdir() if path == note or path.suffix == ".npz" or path.name.startswith(".")]
    others = sorted(set(work.iterdir()) - set(own))
    if others:
        raise InputError(work, "", "an empty folder, or one of a distillation", others[0].name)
    if not note.is_file() or note.read_text() != owner:
        for path in own:
            path.unlink()
    with written(note) as temporary:
        temporary.write_text(owner)


def observed(observer: Observer, signals: list[Signals], work: Path, name: str, tell: Progress) -> list[Observation]:
    """Every pose, from the work folder where it is there: files `NAME_000.npz` …"""
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


def _expressions(observer: Observer, seen: list[Observation]) -> Expressions:
    shift = np.stack([observer.moved(one) for one in seen])
    colour = np.stack([observer.tinted(one) for one in seen])
    moved = (np.abs(shift).max((0, 2)) > MOVED) | (np.abs(colour).max((0, 2)) > TINTED)
    vertex = np.flatnonzero(moved)
    return Expressions(vertex, shift[:, vertex], colour[:, vertex])


def _baked(observer: Observer, signals: list[Signals], places: Texels, tell: Progress) -> tuple[np.ndarray, np.ndarray]:
    """Albedo of the texels (x, 3), and of the vertices (v, 3) in the same poses: the face of the standing one."""
    mesh = observer.mesh
    bake = Bake(places, mesh.faces, len(mesh.vertices))
    mouth, face = torch.as_tensor(mesh.mouth), torch.as_tensor(mesh.part == PARTS.index("face") + 1)
    stand = Signals.rest().replace(body_pose=named_pose("stand"))
    poses = [(stand, torch.where(mouth, HIDDEN, 1.0)), *((one, (~face).float()) for one in signals)]
    for number, (one, weight) in enumerate(poses):
        tell("texture", number, len(poses) + 1)
        exact, followed = observer.follow(one)
        bake.add(exact, followed, observer.light(followed), weight)
    tell("texture", len(poses), len(poses) + 1)
    exact, followed = observer.open_mouth(stand.replace(expression=PARTING * named_expression("jaw_open")))
    lips = torch.as_tensor(observer.lips)
    bake.add(exact, followed, observer.light(followed), torch.where(mouth, 1.0, PARTED * lips) * face)
    colours, at_vertices = bake.texels_and_vertices()
    return _eyes_continued(observer, stand, places, colours), at_vertices


def _eyes_continued(observer: Observer, stand: Signals, places: Texels, colours: np.ndarray) -> np.ndarray:
    """The texture, where lids cover the standing pose's eyes with the nearest colour of an eye that is seen: a lid's would turn with it."""
    mesh, (_, followed) = observer.mesh, observer.follow(stand)
    of_eye = np.flatnonzero(observer.eyes[mesh.faces].all(1)[places.face])
    if not len(of_eye):
        return colours
    posed = followed.position.numpy().astype(np.float64)
    seen = shown(places.interpolated(mesh.faces, posed)[of_eye], posed, mesh.faces)
    place = places.interpolated(mesh.faces, mesh.vertices)
    known, covered, continued = of_eye[seen], of_eye[~seen], colours.copy()
    continued[covered] = colours[known][cKDTree(place[known]).query(place[covered])[1]]
    return continued
