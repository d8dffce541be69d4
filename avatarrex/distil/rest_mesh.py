"""The mesh of the surface: marching cubes on the exact field in an open pose, taken back to rest; hands and face of the template.

The open pose spreads legs and arms, so that crotch and armpits are two surfaces. Where a part has taken over from the body
(ω above `PART_ALONE`) the cubes' mesh ends; the part's own vertices begin below that (ω above `PART_BEGINS`): both lie on one
surface there and overlap without a seam to sew. Towards their rim the part's vertices go more and more as the body's do, or a bent
wrist would lift the rim off the arm.

Letters: v vertices, f faces. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Float32, Int32, UInt8
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.distil.exact import ExactPose
from avatarrex.distil.hidden import caps, hidden, joined_to
from avatarrex.distil.onto_field import onto_field
from avatarrex.ops.closest_point import closest_point
from avatarrex.signals.driving import Signals
from avatarrex.surface.surface import INFLUENCES
from avatarrex.templates.model import EYES, TEETH
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import Person

CELL = 0.006
"""Metres between samples of the cubes: as fine as cloth folds that a depth of 1 mm shows."""
COARSE = 4
"""Cells a side of the blocks that are searched for the surface first."""
NEAR = 0.05
"""Metres from the guessed surface beyond which no block is sampled."""
BODY_TRIANGLES = 16000
"""Edges of 1.3 cm: a limb of 5 cm radius is 0.4 mm off between its vertices."""
PART_BEGINS, PART_ALONE = 0.4, 0.85
"""Shares ω between which both meshes are there."""
REACH = np.array([0.02, 0.004, 0.004, 0.006], np.float32)
"""Metres, of body, hands and face; where a part and the body are both there, it is the body's."""
SMALLEST_PIECE = 0.02
"""Share of the largest piece's area below which a piece is none of the surface."""


@dataclass(frozen=True)
class RestMesh:
    """Vertices at rest with what carries them; see `Surface`."""

    vertices: Float32[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]
    joint: UInt8[np.ndarray, "v k"]
    weight: Float32[np.ndarray, "v k"]
    template_face: Int32[np.ndarray, " v"]
    barycentric: Float32[np.ndarray, "v 3"]
    part: UInt8[np.ndarray, " v"]
    template_vertex: Int32[np.ndarray, " v"]
    """The template's vertex that each is, −1 those of the cubes."""
    alone: Float32[np.ndarray, " v"]
    """How far a vertex goes by its part's template: 0 those of the cubes and of a part's rim, 1 where the part is alone."""
    reach: Float32[np.ndarray, " v"]
    """Metres that the exact surface may be off the place where skin or template has a vertex; 0: it is not looked for."""
    inner: Bool[np.ndarray, " v"]
    """Eyes, and what no side of the head shows (hidden.py): other flesh may lie over them."""
    mouth: Bool[np.ndarray, " v"]
    """What the lips enclose, their inner sides with it."""
    residual: Float32[np.ndarray, "n 3"]
    """Δn_i of the open pose: the nodes' places that the rest positions refer to."""


def open_pose() -> Signals:
    """Arms half down, legs apart."""
    pose = np.zeros((21, 3))
    pose[0, 2], pose[1, 2] = 0.22, -0.22
    pose[15, 2], pose[16, 2] = -0.6, 0.6
    return Signals.rest().replace(body_pose=pose)


def rest_mesh(avatar: Avatar, triangles: int = BODY_TRIANGLES) -> RestMesh:
    """The mesh of an avatar; `triangles` of the body without the parts."""
    exact = ExactPose.of(avatar, open_pose())
    vertices, faces = _cubes(exact)
    vertices, faces = _simplified(exact, vertices, faces, triangles)
    most = torch.full((len(vertices),), float(REACH[0]))
    start = torch.as_tensor(vertices, dtype=torch.float32)
    position, _ = onto_field(exact, start, torch.as_tensor(faces), most)
    return _joined(avatar, exact, position, faces)


def _cubes(exact: ExactPose) -> tuple[np.ndarray, np.ndarray]:
    """Marching cubes on the composed field, largest pieces only."""
    low, high = exact.field.bounds
    counts = np.ceil((high - low) / (CELL * COARSE)).astype(int) + 1
    blocks = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 3)
    middle = low + (blocks + 0.5) * CELL * COARSE
    guess = exact.field.body.skin.query(middle).guess
    radius = np.sqrt(3) / 2 * CELL * COARSE
    sampled = blocks[np.abs(guess) < NEAR + radius]
    grid = np.where(guess < 0, -1.0, 1.0).reshape(counts).astype(np.float32)
    grid = grid.repeat(COARSE, 0).repeat(COARSE, 1).repeat(COARSE, 2)
    inner = np.stack(np.meshgrid(*[np.arange(COARSE)] * 3, indexing="ij"), -1).reshape(-1, 3)
    index = (sampled[:, None] * COARSE + inner).reshape(-1, 3)
    points = torch.as_tensor(low + index * CELL, dtype=torch.float32)
    values = torch.cat([exact.field.sdf(part) for part in points.split(200_000)])
    grid[tuple(index.T)] = values.numpy()
    vertices, faces, _, _ = marching_cubes(grid, 0.0, spacing=(CELL,) * 3)  # type: ignore[no-untyped-call]
    mesh = trimesh.Trimesh(vertices + low, faces, process=True)
    groups = trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(mesh.faces)))
    areas = [float(mesh.area_faces[group].sum()) for group in groups]
    kept = np.concatenate([group for group, area in zip(groups, areas) if area > SMALLEST_PIECE * max(areas)])
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)[np.sort(kept)]


def _simplified(
    exact: ExactPose, vertices: np.ndarray, faces: np.ndarray, triangles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Without what the parts replace, fewer triangles."""
    omega = exact.field(torch.as_tensor(vertices, dtype=torch.float32)).part_weight.amax(-1).numpy()
    faces = faces[(omega[faces] < PART_ALONE).any(1)]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    reduction = 1 - triangles / len(mesh.faces)
    points, fewer = fast_simplification.simplify(
        np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), reduction
    )
    return points.astype(np.float64), fewer.astype(np.int64)


def _joined(avatar: Avatar, exact: ExactPose, position: Float[Tensor, "p 3"], faces: np.ndarray) -> RestMesh:
    """The cubes' mesh taken to rest, and the parts' own vertices."""
    person, frame = avatar.person, exact.field.body.frame
    neighbours = frame.samples.neighbours_of(position)
    rest = frame.samples.rest_position(position, neighbours).numpy()
    weights = neighbours.mean(avatar.body.sample_weights).numpy()
    body = person.body
    omega = person.blend_weight.numpy() * [name not in avatar.hidden for name in PARTS]
    own = body.faces.numpy()[(omega[body.faces.numpy()].min(1) > PART_BEGINS).any(-1)]
    used, own = np.unique(own, return_inverse=True)
    part = np.concatenate([np.zeros(len(rest)), omega[used].argmax(1) + 1]).astype(np.uint8)
    share = np.clip((omega[used].max(1) - PART_BEGINS) / (PART_ALONE - PART_BEGINS), 0, 1)[:, None]
    beside = weights[cKDTree(rest).query(body.v_template.numpy()[used])[1]]
    joint, weight = _strongest(np.concatenate([weights, beside + share * (body.weights.numpy()[used] - beside)]))
    inner, mouth, open_rim = _inner(avatar.person, omega[:, PARTS.index("face")] > PART_BEGINS)
    all_rest = np.concatenate([rest, body.v_template.numpy()[used]]).astype(np.float32)
    own = own.reshape(-1, 3)
    own = np.concatenate([own, caps(own, open_rim[used])]) + len(rest)
    inner, mouth = (np.concatenate([np.zeros(len(rest), bool), group[used]]) for group in (inner, mouth))
    alone = np.concatenate([np.zeros(len(rest)), share[:, 0]]).astype(np.float32)
    found = closest_point(body.v_template, body.faces, torch.as_tensor(all_rest), None)
    return RestMesh(
        vertices=all_rest,
        faces=np.concatenate([faces, own]).astype(np.int32),
        joint=joint,
        weight=weight,
        template_face=found.face.numpy().astype(np.int32),
        barycentric=found.barycentric.numpy().astype(np.float32),
        part=part,
        template_vertex=np.concatenate([np.full(len(rest), -1), used]).astype(np.int32),
        alone=alone,
        reach=np.where(inner, 0, REACH[part * (alone == 1)]).astype(np.float32),
        inner=inner,
        mouth=mouth,
        residual=frame.code.residual.numpy(),
    )


def _inner(person: Person, face: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of the template (v,): eyes and what is hidden in the `face`; the mouth; its throat, which is open behind."""
    body, ids = person.body, person.face.body_vertex_ids.numpy()
    inside = np.zeros(len(body.v_template), bool)
    inside[ids[person.face.inside.numpy() & (ids >= 0)]] = True
    teeth, eyes = (body.of_groups(names).numpy() for names in (TEETH, EYES))
    vertices, faces = body.v_template.double().numpy(), body.faces.numpy()
    unseen = hidden(vertices, faces, face)
    mouth = joined_to(inside, unseen, faces)
    return eyes | unseen | mouth, mouth, mouth & ~teeth


def _strongest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The strongest joints and their shares, from (v, j)."""
    joint = np.argsort(-weights, 1, "stable")[:, :INFLUENCES]
    weight = np.take_along_axis(weights, joint, 1)
    return joint.astype(np.uint8), (weight / weight.sum(1, keepdims=True)).astype(np.float32)
