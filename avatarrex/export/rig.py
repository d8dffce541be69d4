"""A surface as other programs know one: a mesh skinned to 55 joints, with named morph targets and one texture.

    p = Σ_k w_k A_{j_k} (p̄ + morph·ψ)

What formats cannot say is left out: corrections by the pose, changes of colour, light that follows the normal (its mean is baked).
Feet stand on y = 0, the person faces +Z, +Y is up: glTF's own convention, and VRM's T-pose.

Letters: v vertices, t texture vertices, f faces, k joints of a vertex, j joints, m vertices of a morph target. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int32, UInt8

from avatarrex.export.texture import baked_texture
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import blend, joint_transforms, skin, skinning_matrices
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.surface.surface import Surface
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.person import Person

NOT_MOVED = 1e-5
"""Metres: a morph target leaves vertices alone that it moves less (a pixel of a whole person at 1024² is 2e-3)."""


@dataclass(frozen=True, eq=False)
class Morph:
    """One expression at 1."""

    name: str
    vertex: Int32[np.ndarray, " m"]
    offset: Float32[np.ndarray, "m 3"]


@dataclass(frozen=True, eq=False)
class Rig:
    """What every animated format writes."""

    vertices: Float32[np.ndarray, "v 3"]
    normals: Float32[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]
    uv: Float32[np.ndarray, "t 2"]
    """(0, 0) is the top left corner of the texture."""
    uv_vertex: Int32[np.ndarray, " t"]
    uv_faces: Int32[np.ndarray, "f 3"]
    joint: UInt8[np.ndarray, "v k"]
    weight: Float32[np.ndarray, "v k"]
    """Sum 1, the strongest first; an unused one is 0, of joint 0."""
    places: Float64[np.ndarray, "j 3"]
    """Of the joints at rest; their axes are the world's."""
    parents: tuple[int, ...]
    morphs: tuple[Morph, ...]
    """In the order of `EXPRESSION_NAMES`."""
    texture: UInt8[np.ndarray, "h w 3"]

    def limited(self, bones: int) -> Rig:
        """The same with the strongest `bones` joints of each vertex, their weights scaled to sum 1."""
        weight = self.weight[:, :bones].astype(np.float64)
        return replace(self, joint=self.joint[:, :bones], weight=_summing_to_one(weight))

    def moved(self, signals: Signals) -> Float64[np.ndarray, "v 3"]:
        """The vertices as any program poses them: the equation of the module, the root's turn and place included."""
        rest = self.vertices.astype(np.float64)
        for coefficient, morph in zip(signals.expression, self.morphs):
            rest[morph.vertex] += coefficient * morph.offset
        rotation = matrix_from_rotvec(torch.from_numpy(signals.full_pose()))
        places = torch.from_numpy(self.places)
        skinning = skinning_matrices(joint_transforms(rotation, places, self.parents), places)
        dense = np.zeros((len(rest), len(places)))
        np.add.at(dense, (np.arange(len(rest))[:, None], self.joint), self.weight.astype(np.float64))
        posed = skin(blend(skinning, torch.from_numpy(dense)), torch.from_numpy(rest))
        return np.asarray(posed.numpy() + signals.translation)


def rig_of(surface: Surface, person: Person, factor: Float[np.ndarray, "v 3"]) -> Rig:
    """The rig of a distilled surface in the person's mean shape; `factor` is the light that its texture gets (texture.py)."""
    normals = vertex_normals(torch.from_numpy(surface.vertices), torch.from_numpy(surface.faces).long())
    up = lifted(surface)
    weight = _summing_to_one(surface.weight.astype(np.float64))
    return Rig(
        vertices=(surface.vertices + up).astype(np.float32),
        normals=_unit(normals.numpy()),
        faces=surface.faces,
        uv=surface.uv,
        uv_vertex=surface.uv_vertex,
        uv_faces=surface.uv_faces,
        joint=np.where(weight > 0, surface.joint, 0).astype(np.uint8),
        weight=weight,
        places=person.body.joint_template.double().numpy() + up,
        parents=person.body.parents,
        morphs=tuple(_morph(surface, e) for e in range(len(EXPRESSION_NAMES))),
        texture=baked_texture(surface, factor),
    )


def lifted(surface: Surface) -> Float64[np.ndarray, "3"]:
    """What is added to the avatar's own space, metres: there the pelvis is near the origin, in files the soles are."""
    return np.array([0.0, -float(surface.vertices[:, 1].min()), 0.0])


def _morph(surface: Surface, expression: int) -> Morph:
    offset = surface.morph[expression]
    moved = np.linalg.norm(offset, axis=1) > NOT_MOVED
    order = np.argsort(surface.morph_vertex[moved])
    vertex = surface.morph_vertex[moved][order].astype(np.int32)
    return Morph(EXPRESSION_NAMES[expression], vertex, np.ascontiguousarray(offset[moved][order], np.float32))


def _summing_to_one(weight: np.ndarray) -> np.ndarray:
    """Single precision; what rounding leaves goes to the strongest."""
    rounded: np.ndarray = (weight / weight.sum(1, keepdims=True)).astype(np.float32)
    rounded[:, 0] += 1 - rounded.sum(1, dtype=np.float64).astype(np.float32)
    return rounded


def _unit(normals: np.ndarray) -> np.ndarray:
    """Unit length to the last bit that single precision has; up where a vertex has no area."""
    length = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
    return np.where(length > 0.5, normals / np.maximum(length, 0.5), [0, 1, 0]).astype(np.float32)
