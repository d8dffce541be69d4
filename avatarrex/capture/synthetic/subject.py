"""The clothed subject: a textured mesh, the ground truth that every avatar figure is measured against.

A union of closed solids (body, T-shirt, trousers, shoes, hair, eyes, teeth, tongue) skinned by the default person's
joints, with pose-dependent wrinkles. Its signed distance is to the *outer* surface of the union, its sign the exact
winding number (solid_distance.py); its colour is a sharp function of the rest surface point (texture.py) under a
fixed studio light in the root frame. The solids come packaged (`tools/build_subject.py`, spec in
assets_spec/subject.json); the body is the person's own template, so that bare hands are exactly the template's hands.

Letters: v vertices, f faces, p points. Root frame, metres, NumPy float64; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import torch

from avatarrex.capture.synthetic.detail import detailed
from avatarrex.capture.synthetic.mesh import interpolated, vertex_normals
from avatarrex.capture.synthetic.shade import studio_light
from avatarrex.capture.synthetic.solid_distance import SolidUnion
from avatarrex.capture.synthetic.texture import albedo
from avatarrex.capture.synthetic.wrinkles import Site, basis, sites, strengths
from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import DATA, require
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import TemplateModel, pose_by_signals
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import Person, load_person

PACKAGED = {"default": "subject.npz", "loose": "subject_loose.npz"}
FACE_SOLIDS = ("left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue")


@dataclass(frozen=True)
class Subject:
    """The subject at rest (T-pose)."""

    person: Person
    model: TemplateModel
    """All solids as one template in the person's joints, shape, expression and pose directions."""
    names: tuple[str, ...]
    """Solids: "body" first."""
    solid_of_vertex: np.ndarray
    solid_of_face: np.ndarray
    parts: tuple[str, ...]
    part_of_face: np.ndarray
    """(f,) index into `parts`: the solids, with the body split into skin, left_hand, right_hand and face."""
    masks: dict[str, np.ndarray]
    """(v,) metres or weights that the texture reads."""
    openness: np.ndarray
    """(v,) 1 − ambient occlusion, baked in an A-pose."""
    wrinkle_sites: tuple[Site, ...]
    wrinkle_basis: np.ndarray
    """(v, k) metres."""
    pattern: np.ndarray
    """(v, 3) where the texture is read: rest positions of the default person."""
    palette: dict[str, np.ndarray] = field(default_factory=dict)
    """(3, 3) by solid: its colours from those of the texture; none: as painted."""
    detailed: bool = False
    """Whether the texture has photographic detail (detail.py)."""

    @cached_property
    def vertices(self) -> np.ndarray:
        """(v, 3) rest positions."""
        return self.model.v_template.double().numpy()

    @cached_property
    def faces(self) -> np.ndarray:
        """(f, 3) int64."""
        return np.ascontiguousarray(self.model.faces.numpy())

    @cached_property
    def normals(self) -> np.ndarray:
        """(v, 3) rest unit normals."""
        return vertex_normals(self.vertices, self.faces)

    @cached_property
    def _pattern_normals(self) -> np.ndarray:
        return vertex_normals(self.pattern, self.faces)

    @property
    def person_joints(self) -> np.ndarray:
        """(55, 3) of the default person at rest: the pattern's."""
        return load_person().body.joint_template.double().numpy()

    def pose(self, signals: Signals) -> PosedSubject:
        """The subject under `signals` in the root frame: global orientation and translation are left out."""
        wrinkle = self.wrinkle_basis @ strengths(list(self.wrinkle_sites), signals.full_pose())
        moved = (self.vertices + self.normals * wrinkle[:, None]).astype(np.float32)
        model = replace(self.model, v_template=torch.from_numpy(moved))
        vertices = pose_by_signals(model, signals).vertices.double().numpy()
        return PosedSubject(self, vertices, vertex_normals(vertices, self.faces), wrinkle)

    def albedo(self, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """(p, 3) unlit sRGB colour of surface points."""
        corners = self.faces[face]
        rest, normal = (interpolated(bary, values[corners]) for values in (self.pattern, self._pattern_normals))
        masks = {name: interpolated(bary, mask[corners]) for name, mask in self.masks.items()}
        solids = np.array(self.names)[self.solid_of_face[face]]
        colour = albedo(solids.tolist(), rest, normal, masks)
        for name, matrix in self.palette.items():
            colour[solids == name] = np.clip(colour[solids == name] @ matrix.T, 0, 1)
        return detailed(solids, rest, normal, masks, colour) if self.detailed else colour

    def faces_of(self, *parts: str) -> np.ndarray:
        """Faces of the named parts; "face" also takes eyes, teeth and tongue, "body" all skin."""
        wanted = set(parts)
        if "face" in wanted:
            wanted |= set(FACE_SOLIDS)
        if "body" in wanted:
            wanted |= {"skin", *PARTS}
        unknown = wanted - set(self.parts) - {"body"}
        if unknown:
            raise InputError("subject", "part", "one of " + ", ".join(self.parts), ", ".join(sorted(unknown)))
        return np.flatnonzero(np.isin(self.part_of_face, [k for k, name in enumerate(self.parts) if name in wanted]))


@dataclass(frozen=True)
class PosedSubject:
    """The subject under one driving signal."""

    subject: Subject
    vertices: np.ndarray
    """(v, 3) root frame."""
    normals: np.ndarray
    """(v, 3) unit vertex normals."""
    wrinkle: np.ndarray
    """(v,) metres of folds along the rest normal."""

    @cached_property
    def solids(self) -> SolidUnion:
        """The union's distance structure, made on first use (about a second)."""
        return SolidUnion(self.vertices, self.subject.faces)

    @property
    def faces(self) -> np.ndarray:
        """(f, 3), the subject's."""
        return self.subject.faces

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """(p,) metres to the outer surface, negative inside the union."""
        return self.solids.signed_distance(points)

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest outer surface point of each point: face (p,), barycentrics (p, 3)."""
        _, face, bary = self.solids.closest(points)
        return face, bary

    def sample(
        self, count: int, rng: np.random.Generator, part: str | tuple[str, ...] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Area-uniform points of the outer surface (of `part`): face (count,), barycentrics (count, 3).

        Points that lie inside another solid are drawn again, so none is buried. Raises `InputError` (unknown part).
        """
        wanted = (part,) if isinstance(part, str) else part
        ids = np.arange(len(self.faces)) if wanted is None else self.subject.faces_of(*wanted)
        return self.solids.sample(count, rng, np.intersect1d(ids, self.solids.outer))

    def at(self, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (p, 3) and unit smooth normals (p, 3) of surface points."""
        corners = self.faces[face]
        normal = interpolated(bary, self.normals[corners])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return interpolated(bary, self.vertices[corners]), normal

    def colour(self, points: np.ndarray) -> np.ndarray:
        """(p, 3) sRGB in [0, 1] of the outer surface nearest to each point, lit."""
        return self.colour_at(*self.closest(points))

    def colour_at(self, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """(p, 3) sRGB in [0, 1] of surface points under the studio light of the root frame."""
        _, normal = self.at(face, bary)
        corners = self.faces[face]
        openness, wrinkle = (interpolated(bary, values[corners]) for values in (self.subject.openness, self.wrinkle))
        return studio_light(self.subject.albedo(face, bary), normal, openness, wrinkle)


@lru_cache(maxsize=2)
def load_subject(name: str = "default") -> Subject:
    """A packaged subject ("default", or "loose" in a wide tunic) or one from an `.npz` in the same layout.

    Raises `InputError`.
    """
    path = DATA / PACKAGED[name] if name in PACKAGED else Path(name)
    arrays = read_arrays(path)
    person = load_person()
    found = str(require(arrays, path, "person_hash", ()))
    if found != person.hash:
        raise InputError(path, "person_hash", f"{person.hash}: rebuild it with tools/build_subject.py", found)
    names = ("body", *(str(n) for n in require(arrays, path, "names", (None,))))
    model = _combined(person.body, arrays, path)
    body = len(person.body.groups["body"])
    body_faces = len(model.faces) - int(arrays["face_count"].sum())
    solid_of_vertex = np.repeat(np.arange(len(names)), [body, *arrays["vertex_count"]])
    solid_of_face = np.repeat(np.arange(len(names)), [body_faces, *arrays["face_count"]])
    parts, part_of_face = _parts(person, names, solid_of_face, model.faces.numpy())
    v = len(model.v_template)
    masks = {key[5:]: require(arrays, path, key, (v,)).astype(np.float64) for key in arrays if key.startswith("mask_")}
    joints = dict(zip(model.joint_names, person.body.joint_template.double().numpy()))
    measures = require(arrays, path, "measures", (2,)).astype(np.float64)
    folds = sites(joints, model.joint_names, *measures.tolist())
    rest = model.v_template.double().numpy()
    return Subject(
        person=person,
        model=model,
        names=names,
        solid_of_vertex=solid_of_vertex,
        solid_of_face=solid_of_face,
        parts=parts,
        part_of_face=part_of_face,
        masks=masks,
        openness=require(arrays, path, "openness", (v,)) / 255.0,
        wrinkle_sites=tuple(folds),
        pattern=rest,
        wrinkle_basis=basis(folds, rest, np.array(names)[solid_of_vertex])
        * masks["interior"][:, None].astype(np.float32),
    )


def _combined(body: TemplateModel, arrays: dict[str, np.ndarray], path: Path) -> TemplateModel:
    """One template: the body's own vertices (tucked under cloth), then the packaged solids bound to it."""
    n = len(body.groups["body"])
    v = int(arrays["vertex_count"].sum())
    tuck = torch.from_numpy(require(arrays, path, "tuck", (n, 3)).astype(np.float32))
    corner = body.faces[torch.from_numpy(require(arrays, path, "bind_face", (v,)).astype(np.int64))]
    bary = torch.from_numpy(require(arrays, path, "bind_bary", (v, 3)).astype(np.float32))
    bary = bary / bary.sum(1, keepdim=True)
    joint = torch.from_numpy(require(arrays, path, "weight_joint", (v, None)).astype(np.int64))
    weight = torch.from_numpy(require(arrays, path, "weight", tuple(joint.shape)).astype(np.float32))
    weights = torch.zeros(v, body.weights.shape[1]).scatter_add_(1, joint, weight / weight.sum(1, keepdim=True))

    def bound(directions: torch.Tensor) -> torch.Tensor:
        return torch.cat([directions[:n], (directions[corner] * bary[:, :, None, None]).sum(1)])

    start = np.cumsum([n, *arrays["vertex_count"]])[:-1]
    packaged = arrays["faces"].astype(np.int64) + np.repeat(start, arrays["face_count"])[:, None]
    rest = torch.from_numpy(require(arrays, path, "vertices", (v, 3)).astype(np.float32))
    return replace(
        body,
        v_template=torch.cat([body.v_template[:n] + tuck, rest]),
        faces=torch.cat([body.faces[(body.faces < n).all(1)], torch.from_numpy(packaged)]),
        shapedirs=bound(body.shapedirs),
        expression_dirs=bound(body.expression_dirs),
        weights=torch.cat([body.weights[:n], weights]),
        posedirs=None if body.posedirs is None else bound(body.posedirs),
        groups={},
    )


def _parts(
    person: Person, names: tuple[str, ...], solid_of_face: np.ndarray, faces: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Part names and each face's part: the body is split by the painted weights of hands and face."""
    parts = ("skin", *PARTS, *names[1:])
    label = solid_of_face + 3
    body = np.flatnonzero(solid_of_face == 0)
    painted = person.blend_weight.numpy()[faces[body]].mean(1)
    label[body] = np.where(painted.max(1) > 0.5, painted.argmax(1) + 1, 0)
    return parts, label
