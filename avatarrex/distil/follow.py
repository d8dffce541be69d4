"""Where each vertex of the rest mesh lies on the exact surface of a pose, and its colour there.

A vertex of the cubes goes by skinning, then by fixed-point steps to the point that the local networks see where they saw the
vertex in the open pose, T⁻¹(p) − Σ w_i (Δn_i − Δn_i of the open pose) / Σ w_i = p̄: nodes move by millimetres with the pose, and a
printed pattern with them. A vertex of a part goes by that part's own template, at its rim by both.
Then all go along the normal onto the exact field.

Letters: v vertices, k joints of a vertex, j joints. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.avatar import Avatar
from avatarrex.distil.exact import ExactPose
from avatarrex.distil.onto_field import LONGEST_STEP, ON_SURFACE, at_most, onto_field
from avatarrex.distil.rest_mesh import RestMesh
from avatarrex.fields.influence import weighted_mean
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import joint_transforms, skin, skinning_matrices
from avatarrex.signals.driving import Signals
from avatarrex.templates.counterpart import counterpart
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import Person

FRAME_STEPS = 4
"""Fixed-point steps into the local frame: halve the miss each."""
MISSED = 0.004
"""Metres off its own rest position from which a vertex is not trusted: where limbs touch, no point may have that rest position."""
ROUNDS, AROUND = 12, 3.0
"""Means over neighbours that make a face's broad normals, a centimetre wide, and how much these count beside a vertex' own."""
SEEN = 3e-3
"""Metres of |s| up to which an inner vertex, which is not moved, has the colour of the surface."""


@dataclass(frozen=True)
class Followed:
    """The vertices in one pose."""

    position: Float[Tensor, "v 3"]
    start: Float[Tensor, "v 3"]
    """Before they went along the normal."""
    skinned: Float[Tensor, "v 3"]
    """Where plain skinning puts them."""
    matrix: Float[Tensor, "v 3 4"]
    """Their blended skinning matrices."""
    normal: Float[Tensor, "v 3"]
    """Of the mesh."""
    found: Bool[Tensor, " v"]
    """On the exact surface, at their own rest position."""
    broad: Float[Tensor, "v 3"]
    """At a face the unit mean normal around; 0 elsewhere."""

    @property
    def gaze(self) -> Float[Tensor, "v 3"]:
        """Unit, along which colours are looked at: against the normal, at a face against that of the skin around.

        Along the normal of a lid's edge, or of a nostril, nobody ever looked, and the networks say anything. Temples are seen from
        aside: halfway to the front they were darker by a tenth than what lies beside them.
        """
        return -normalize(self.normal + AROUND * self.broad, dim=-1)


def skinning(person: Person, signals: Signals) -> Float[Tensor, "55 4 4"]:
    """Skinning matrices of all joints: body, jaw, eyes, fingers; the root frame, without orientation and translation."""
    pose = torch.as_tensor(signals.full_pose(), dtype=torch.float32)
    pose[0] = 0
    body = person.body
    shape = torch.tensor(signals.shape.tolist())
    joints = body.joint_template + body.joint_shapedirs[..., : len(shape)] @ shape[: body.joint_shapedirs.shape[2]]
    return skinning_matrices(joint_transforms(matrix_from_rotvec(pose), joints, body.parents), joints)


def follow(avatar: Avatar, mesh: RestMesh, exact: ExactPose, signals: Signals) -> Followed:
    """Every vertex of `mesh` on the exact surface of `signals`."""
    rest = torch.as_tensor(mesh.vertices)
    weight = torch.as_tensor(mesh.weight)
    matrices = skinning(avatar.person, signals)[:, :3]
    matrix = (matrices[torch.as_tensor(mesh.joint.astype(np.int64))] * weight[..., None, None]).sum(1)
    skinned = skin(matrix, rest)
    start, framed = skinned.clone(), torch.ones(len(rest), dtype=torch.bool)
    alone = torch.as_tensor(mesh.alone)
    body = alone < 1
    start[body], framed[body] = _in_local_frame(
        exact, torch.as_tensor(mesh.residual), rest[body], skinned[body], matrix[body, :, :3]
    )
    for number, name in enumerate(PARTS, 1):
        own = torch.as_tensor(mesh.part == number)
        if own.any():
            vertex = torch.as_tensor(mesh.template_vertex[own.numpy()].astype(np.int64))
            aside = (matrix[own, :, :3] @ (rest[own] - avatar.person.body.v_template[vertex])[:, :, None])[:, :, 0]
            template = _on_template(avatar, exact, name, vertex) + aside
            start[own] = start[own].lerp(template, alone[own, None])
    faces = torch.as_tensor(mesh.faces.astype(np.int64))
    position, missed = onto_field(exact, start, faces, torch.as_tensor(mesh.reach))
    found = framed & (missed < torch.where(torch.as_tensor(mesh.inner), SEEN, ON_SURFACE))
    face, normal = torch.as_tensor(mesh.part == PARTS.index("face") + 1), vertex_normals(position, faces)
    return Followed(position, start, skinned, matrix, normal, found, face[:, None] * broad_normals(normal, faces))


def broad_normals(normal: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Float[Tensor, "v 3"]:
    """Unit means of normals over triangles, `ROUNDS` times."""
    broad = normal
    for _ in range(ROUNDS):
        mean = torch.zeros_like(broad)
        for corner in faces.T:
            mean.index_add_(0, corner, broad[faces].sum(1))
        broad = normalize(mean, dim=-1)
    return broad


def _in_local_frame(
    exact: ExactPose,
    residual: Float[Tensor, "n 3"],
    rest: Float[Tensor, "v 3"],
    start: Float[Tensor, "v 3"],
    linear: Float[Tensor, "v 3 3"],
) -> tuple[Tensor, Tensor]:
    """Points that the networks see at `rest`, and whether they were found."""
    position = start
    for _ in range(FRAME_STEPS):
        miss = rest - _material(exact, residual, position)
        position = position + at_most((linear @ miss[:, :, None])[:, :, 0], torch.tensor(LONGEST_STEP))
    good = (rest - _material(exact, residual, position)).norm(dim=-1) < MISSED
    return torch.where(good[:, None], position, start), good


@torch.no_grad()
def _material(exact: ExactPose, residual: Float[Tensor, "n 3"], position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
    """Where the local networks see points, as if their nodes had the residuals `residual`."""
    body, frame = exact.field.body.field, exact.field.body.frame
    pairs, _, weight = body.localise(frame, position, body.pairs(frame, position))
    moved = (frame.code.residual - residual)[pairs.node]
    shift, total = weighted_mean(moved, weight, pairs, len(position))
    return frame.samples.rest_position(position) - torch.where(total[:, None] > 0, shift, torch.zeros_like(shift))


def _on_template(avatar: Avatar, exact: ExactPose, name: str, vertex: Int[Tensor, " p"]) -> Float[Tensor, "p 3"]:
    """The part's own posed mesh at these vertices of the body template."""
    local = counterpart(avatar.person, name).posed(exact.posed.parts[name], vertex)
    place = torch.as_tensor(exact.posed.root_from_part(name), dtype=torch.float32)
    return local @ place[:3, :3].T + place[:3, 3]
