"""The clothed subject: a textured mesh, the ground truth that every avatar figure is measured against.

A union of closed solids (body, shirt, trousers, shoes, hair, eyes, teeth, tongue) skinned by the default person's joints,
with pose-dependent wrinkles. Its signed distance is to the *outer* surface of the union and its sign is the winding number
against ½; buried surfaces (skin under cloth, the insides of garments) do not count. Needs libigl (extra `sdf`).

Letters: v vertices, f faces, p points. Root frame, metres, NumPy float64; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
import trimesh

from avatarrex.capture.garments import TUCK, Solid, averaging, garment, normals_of, shoe
from avatarrex.capture.texture import TEXTURES, value_noise
from avatarrex.errors import InputError
from avatarrex.signals.signals import Signals
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import Person, load_person

try:
    import igl
except ImportError:  # the extra `sdf`; `load_subject` names it
    igl = None

KEY_LIGHT = np.array([0.35, 0.6, 0.72])
FILL_LIGHT = np.array([-0.7, 0.2, 0.5])


@dataclass(frozen=True)
class PosedSubject:
    """The subject under one driving signal."""

    subject: Subject
    vertices: np.ndarray
    normals: np.ndarray

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """(p,) metres to the outer surface, negative inside the union."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        outer = self.subject.faces[self.subject.outer]
        squared, _, _ = igl.point_mesh_squared_distance(points, self.vertices, outer)
        inside = igl.fast_winding_number(self.vertices, self.subject.faces, points) > 0.5
        return np.where(inside, -1.0, 1.0) * np.sqrt(squared)

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest outer face (p,) and barycentrics (p, 3) there."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        ids = np.flatnonzero(self.subject.outer)
        _, face, nearest = igl.point_mesh_squared_distance(points, self.vertices, self.subject.faces[ids])
        face = ids[np.asarray(face).ravel()]
        corners = self.vertices[self.subject.faces[face]]
        bary = trimesh.triangles.points_to_barycentric(corners, nearest)
        return face, np.nan_to_num(np.clip(bary, 0, 1), nan=1 / 3)

    def sample(self, count: int, rng: np.random.Generator, faces: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Area-uniform samples of the outer surface (or of `faces`): face (count,), barycentrics (count, 3)."""
        ids = np.flatnonzero(self.subject.outer) if faces is None else faces
        a, b, c = (self.vertices[self.subject.faces[ids, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        face = ids[rng.choice(len(ids), count, p=area / area.sum())]
        u, v = rng.random(count), rng.random(count)
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        return face, np.stack([1 - u - v, u, v], 1)

    def at(self, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and unit normals (p, 3) of surface points."""
        corners = self.subject.faces[face]
        position = np.einsum("pk,pkc->pc", bary, self.vertices[corners])
        normal = np.einsum("pk,pkc->pc", bary, self.normals[corners])
        return position, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    def colour(self, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """(p, 3) colour of surface points under the fixed studio light of the root frame."""
        _, normal = self.at(face, bary)
        sky = 0.5 + 0.5 * normal[:, 1]
        key = np.clip(normal @ (KEY_LIGHT / np.linalg.norm(KEY_LIGHT)), 0, 1)
        fill = np.clip(normal @ (FILL_LIGHT / np.linalg.norm(FILL_LIGHT)), 0, 1)
        ao = np.einsum("pk,pk->p", bary, self.subject.openness[self.subject.faces[face]])
        light = (0.46 + 0.16 * sky + 0.34 * key + 0.1 * fill) * (0.45 + 0.55 * ao)
        return np.clip(self.subject.albedo(face, bary) * light[:, None] * 1.12, 0, 1)


@dataclass(frozen=True)
class Subject:
    """The subject at rest (T-pose)."""

    person: Person
    solids: tuple[Solid, ...]
    vertices: np.ndarray
    faces: np.ndarray
    solid_of_face: np.ndarray
    weights: torch.Tensor
    expression_dirs: torch.Tensor
    wrinkle: np.ndarray
    masks: dict[str, np.ndarray]
    """Per-vertex masks of the body's texture."""
    outer: np.ndarray
    """(f,) faces on the outer surface of the union at rest."""
    openness: np.ndarray
    """(v,) 1 − ambient occlusion at rest."""

    def pose(self, signals: Signals) -> PosedSubject:
        """Skin the subject; root frame (global orientation and translation are left out)."""
        pose = torch.as_tensor(np.array(signals.full_pose()), dtype=torch.float64)
        pose[0] = 0
        body = self.person.body
        shape = torch.zeros(body.shapedirs.shape[2], dtype=torch.float64)
        expression = torch.as_tensor(np.array(signals.expression), dtype=torch.float64)
        posed = pose_template(body.double(), pose, shape, expression)
        rest = torch.as_tensor(self.vertices) + self.expression_dirs @ expression
        blended = (self.weights @ posed.skinning[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
        vertices = ((blended[:, :, :3] @ rest[:, :, None])[:, :, 0] + blended[:, :, 3]).numpy()
        normals = normals_of(vertices, self.faces)
        vertices = vertices + normals * (self.wrinkle * self._folds(pose.numpy()))[:, None]
        return PosedSubject(self, vertices, normals_of(vertices, self.faces))

    def _folds(self, pose: np.ndarray) -> np.ndarray:
        """(v,) in [−1, 1]: fold pattern times how far the nearest joints bend."""
        bend = 1 - np.cos(np.linalg.norm(pose, axis=1))
        strength = np.clip(self.weights.numpy() @ bend * 1.5, 0, 1)
        x, y, z = self.vertices.T
        phase = 2 * np.pi * (y + 0.35 * np.abs(x) + 0.25 * z) / 0.038 + 2.5 * value_noise(self.vertices, 0.06)
        return strength * np.sin(phase)

    def albedo(self, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """(p, 3) procedural colour of surface points."""
        corners = self.faces[face]
        rest = np.einsum("pk,pkc->pc", bary, self.vertices[corners])
        masks = {name: np.einsum("pk,pk->p", bary, mask[corners]) for name, mask in self.masks.items()}
        colour = np.zeros_like(rest)
        for number, solid in enumerate(self.solids):
            here = self.solid_of_face[face] == number
            if not here.any():
                continue
            point = rest[here]
            if solid.name.endswith("_eye"):
                point = point - (solid.vertices.min(0) + solid.vertices.max(0)) / 2
                point /= np.linalg.norm(point, axis=1, keepdims=True)
            colour[here] = TEXTURES[solid.name](point, {name: mask[here] for name, mask in masks.items()})
        return np.clip(colour, 0, 1)

    def faces_of(self, *names: str) -> np.ndarray:
        """Outer faces of the named solids."""
        wanted = [k for k, solid in enumerate(self.solids) if solid.name in names]
        return np.flatnonzero(np.isin(self.solid_of_face, wanted) & self.outer)


@lru_cache(maxsize=1)
def load_subject() -> Subject:
    """Build the default subject from the default person; deterministic, about ten seconds."""
    if igl is None:
        raise InputError("subject", "libigl", "the extra `sdf` (pip install 'avatarrex-studio[sdf]')", "not installed")
    person = load_person()
    solids = _solids(person)
    offsets = np.cumsum([0] + [len(s.vertices) for s in solids])
    vertices = np.concatenate([s.vertices for s in solids])
    faces = np.concatenate([s.faces + o for s, o in zip(solids, offsets)])
    number = np.repeat(np.arange(len(solids)), [len(s.faces) for s in solids])
    masks = {name: np.zeros(len(vertices)) for name in ("lips", "nails", "mouth")}
    for name, mask in _body_masks(person).items():
        masks[name][: len(mask)] = mask
    normals = normals_of(vertices, faces)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normal = np.cross(b - a, c - a)
    face_normal /= np.maximum(np.linalg.norm(face_normal, axis=1, keepdims=True), 1e-20)
    probe = (a + b + c) / 3 + 5e-4 * face_normal
    outer = igl.fast_winding_number(vertices, faces, probe) < 0.5
    occlusion = np.asarray(igl.ambient_occlusion(vertices, faces, vertices + 1e-3 * normals, normals, 128)).ravel()
    masks["mouth"] *= occlusion > 0.75
    return Subject(
        person=person,
        solids=tuple(solids),
        vertices=vertices,
        faces=faces,
        solid_of_face=number,
        weights=torch.as_tensor(np.concatenate([s.weights for s in solids])),
        expression_dirs=torch.as_tensor(np.concatenate([s.expression_dirs for s in solids])),
        wrinkle=np.concatenate([s.wrinkle for s in solids]),
        masks=masks,
        outer=np.asarray(outer).ravel(),
        openness=1 - occlusion,
    )


def _solids(person: Person) -> list[Solid]:
    template = person.body
    rest = template.v_template.double().numpy()
    weights = template.weights.double().numpy()
    expressions = template.expression_dirs.double().numpy()
    faces = template.faces.numpy()

    def group(name: str) -> Solid:
        ids = template.groups[name].numpy()
        index = np.full(len(rest), -1)
        index[ids] = np.arange(len(ids))
        kept = index[faces[(index[faces] >= 0).all(1)]]
        kept = _closed(rest[ids], kept)
        return Solid(name, rest[ids].copy(), kept, weights[ids], expressions[ids], np.zeros(len(ids)))

    body = group("body")
    x, y, z = body.vertices.T
    head = body.weights[:, [12, 15, 22, 23, 24]].sum(1)
    hand = body.weights[:, 25:].sum(1)
    shirt = (np.abs(x) < 0.40) & (y > -0.085) & (head < 0.3)
    trouser = (np.abs(x) < 0.33) & (y < 0.07) & (y > -0.872) & (hand < 0.1)
    line = np.interp(z, [-0.03, 0.0, 0.05, 0.085, 0.1], [0.655, 0.7, 0.748, 0.785, 0.797])
    scalp = (y > line) & (head > 0.9) & ~((np.abs(x) > 0.078) & (y < 0.762) & (z > -0.005))
    waist = np.exp(-(((y - 0.05) / 0.12) ** 2))
    solids = [
        garment("shirt", body, shirt, 0.011 + 0.006 * waist, 14, np.full(len(x), 0.0035)),
        garment("trousers", body, trouser, 0.007 + 0.008 * np.clip((-0.45 - y) / 0.4, 0, 1), 10, np.full(len(x), 0.0035)),
        garment("hair", body, scalp, 0.004 + 0.010 * np.clip((y - line) / 0.035, 0, 1), 3, np.zeros(len(x))),
    ]
    for side, sign in (("left", 1), ("right", -1)):
        solids.append(shoe(f"{side}_shoe", body, (sign * x > 0.02) & (y < -0.855)))
    covered = (shirt & (np.abs(x) < 0.375) & (y > -0.07)) | (trouser & (y < 0.06) & (y > -0.86)) | (y < -0.865)
    covered |= scalp & (y > line + 0.006)
    neighbours = averaging(body.faces, len(x))
    for _ in range(2):  # two rings inside the hem, so that the step to the tucked skin stays under the cloth
        covered = (neighbours @ covered.astype(float) > 0.999) & covered
    tucked = body.vertices - TUCK * covered[:, None] * normals_of(body.vertices, body.faces)
    body = Solid("body", tucked, body.faces, body.weights, body.expression_dirs, body.wrinkle)
    parts = [group(name) for name in ("left_eye", "right_eye", "tongue", "upper_teeth", "lower_teeth")]
    return [body, *solids, *parts]


def _closed(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The same faces with small open loops filled, so that the solid has an inside."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if not mesh.is_watertight:
        trimesh.repair.fill_holes(mesh)
    return np.asarray(mesh.faces) if len(mesh.vertices) == len(vertices) else faces


def _body_masks(person: Person) -> dict[str, np.ndarray]:
    """Lips by what the lip rolls move, nails at the finger tips, mouth by what lies inside the lips; body vertices."""
    template = person.body
    ids = template.groups["body"].numpy()
    rest = template.v_template.double().numpy()[ids]
    names = list(template.expression_names)
    dirs = template.expression_dirs.double().numpy()[ids]
    roll = sum(np.linalg.norm(dirs[:, :, names.index(name)], axis=1) for name in ("mouthRollLower", "mouthRollUpper"))
    lips = np.clip(roll / roll.max() * 2.2 - 0.5, 0, 1)
    normal = normals_of(rest, person.body.faces.numpy()[(person.body.faces.numpy() < len(ids)).all(1)])
    front = rest[:, 2] > 0.13
    x, y, z = rest.T
    mouth = ((np.abs(x) < 0.036) & (y > 0.62) & (y < 0.68) & (z > 0.05) & (z < 0.122)).astype(float)
    lips = lips * front * (1 - mouth)
    tips = template.weights.double().numpy()[ids][:, [27, 30, 33, 36, 42, 45, 48, 51]].max(1)
    last = np.zeros(len(ids))
    for joint in (27, 30, 33, 36, 42, 45, 48, 51):
        sign = 1 if joint < 40 else -1
        tip = template.joint_template.double().numpy()[joint]
        last = np.maximum(last, ((sign * (x - tip[0]) > 0.012) & (np.hypot(y - tip[1], z - tip[2]) < 0.02)).astype(float))
    return {"lips": lips, "mouth": mouth, "nails": last * (tips > 0.5) * (normal[:, 1] > 0.6)}
