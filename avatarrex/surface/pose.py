"""A surface under a driving signal: the equations of surface.py, and normals of the mesh that they make.

    p̄' = p̄ + shape·β + morph·ψ + Δp      p = Σ_k w_k A_{j_k} p̄'      tint = Δc + morph_colour·ψ
    n = unit Σ_{faces at v} (p_b − p) × (p_c − p)

In the root frame: global orientation and translation are not in it (R_0 = I), the camera is moved instead. Jaw and eyes turn about
joints that follow ψ where the template's do (`joint_expression_dirs`). `_posed_reference` reads like the equations in float64; the
compiled loops (pose_loops.py) are 1e-6 m from it.

With a previous pose only what changed is computed: a vertex where a matrix A_j that carries it, its group's correction or its
morphs changed; a normal where a corner of its faces moved. The rest is kept, and equals what would be computed bit for bit.

Letters: v vertices, j joints, g groups, r rank, e expressions. Metres, root frame; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial.transform import Rotation

from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.ops.native import spread
from avatarrex.ops.skinning import tree_levels
from avatarrex.signals.driving import Signals
from avatarrex.surface import pose_loops as loops
from avatarrex.surface.pose_kernel import pose_kernel, turns
from avatarrex.surface.surface import Correction, Surface
from avatarrex.templates.face import HEAD, JAW, LEFT_EYE, RIGHT_EYE
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.person import Person
from avatarrex.templates.transform import world_from_root

FEW = 512
"""Vertices up to which one thread is done before another has started."""


@dataclass(frozen=True, eq=False)
class PosedSurface:
    """A surface as a driving signal places it. Not to be written to: a later pose may keep its arrays."""

    surface: Surface
    person: Person
    vertices: Float32[np.ndarray, "v 3"]
    normals: Float32[np.ndarray, "v 3"]
    """Unit, outwards."""
    tint: Float32[np.ndarray, "v 3"]
    """What pose and expression add to the albedo."""
    joint_transforms: Float64[np.ndarray, "j 4 4"]
    """G_j."""
    key: bytes
    """Of the pose without its root, expression and shape."""
    state: loops.State
    """What the vertices were made from."""

    @cached_property
    def bounds(self) -> Float32[np.ndarray, "2 3"]:
        """Two corners of the vertices' box."""
        columns = np.ascontiguousarray(self.vertices.T)  # numpy's least of a column takes twenty times as long
        return np.stack([columns.min(1), columns.max(1)])

    def world_from_root(self, signals: Signals) -> Float64[np.ndarray, "4 4"]:
        """Rigid: the global orientation about the pelvis, then the translation."""
        pelvis = self.joint_transforms[0, :3, 3]
        return np.asarray(world_from_root(signals.global_orient, signals.translation, pelvis))


def pose_surface(
    surface: Surface,
    person: Person,
    signals: Signals,
    previous: PosedSurface | None = None,
    counters: Counters | None = None,
    impl: str = "auto",
) -> PosedSurface:
    """`surface` of `person` under `signals`; `previous` itself where nothing that it depends on has changed.

    `impl`: `auto`, or `reference` (float64, slow, from nothing). `counters`: `surface_vertices` were placed.
    """
    pose = signals.full_pose()
    pose[0] = 0
    key = pose.tobytes() + signals.expression.tobytes() + signals.shape.tobytes()
    if impl == "reference":
        return _posed_reference(surface, person, signals, key)
    if previous is not None and not (previous.surface is surface and previous.person is person):
        previous = None
    if previous is not None and previous.key == key:
        return previous
    mesh, skeleton = _mesh(surface), _skeleton(person.body)
    turn = Rotation.from_rotvec(pose).as_matrix()
    joints = skeleton.joints(signals)
    transform, skinning = np.empty((2, len(joints), 3, 4))
    loops.joint_matrices(skeleton.order, skeleton.parents, turn, joints, transform, skinning)
    of, amount = surface.correction, np.empty(surface.correction.low.shape)
    own = (turn - np.eye(3)).reshape(-1, 9)
    loops.corrections(own, _fitted(of), of.joints, of.closeness, of.weights, of.low, of.high, amount)
    expression = np.ascontiguousarray(signals.expression[: mesh.morph.shape[1]])
    state = loops.State(_shaped(surface, person.body, signals.shape), skinning, amount, expression)
    vertices, normals, tint, placed = _placed(mesh, state, previous)
    if counters is not None:
        counters.add("surface_vertices", placed)
    return PosedSurface(surface, person, vertices, normals, tint, _square(transform), key, state)


def _placed(
    mesh: loops.Mesh, state: loops.State, previous: PosedSurface | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Vertices, normals, tint (v, 3), and how many vertices were placed."""
    v = len(mesh.joint)
    if previous is None or previous.state.rest is not state.rest:
        moved = turned = np.arange(v)
        vertices, normals, tint = np.empty((3, v, 3), np.float32)
    else:
        old = previous.state
        joint = (old.skinning != state.skinning).any((1, 2))
        group, morphs = (old.amount != state.amount).any(1), bool((old.expression != state.expression).any())
        flag = np.empty((2, v), bool)
        spread(loops.mark_moved, v, mesh, joint, group, morphs, flag[0])
        spread(loops.mark_neighbours, v, mesh, flag[0], flag[1])
        moved, turned = (np.flatnonzero(row) for row in flag)
        vertices, normals, tint = previous.vertices.copy(), previous.normals.copy(), previous.tint.copy()
    spread(loops.place, len(moved), moved, mesh, state, vertices, tint, few=FEW)
    spread(loops.turn_normals, len(turned), turned, mesh, vertices, normals, few=FEW)
    return vertices, normals, tint, len(moved)


@dataclass(frozen=True, eq=False)
class _Skeleton:
    """A template's joints in NumPy."""

    template: np.ndarray
    """(j, 3) float64."""
    shape: np.ndarray
    """(j, 3, s)."""
    expression: np.ndarray | None
    """(j, 3, e): of jaw and eyes, relative to the head's; as the face's template has it."""
    parents: np.ndarray
    order: np.ndarray
    """Parents before children."""

    def joints(self, signals: Signals) -> Float64[np.ndarray, "j 3"]:
        """Rest joints of the signal's shape and expression."""
        used = _checked(signals.shape, self.shape.shape[2])
        joints: np.ndarray = self.template + self.shape[..., :used] @ signals.shape[:used]
        if self.expression is None:
            return joints
        e = min(self.expression.shape[2], len(signals.expression))
        return np.asarray(joints + self.expression[..., :e] @ signals.expression[:e])


_MESHES: WeakKeyDictionary[Surface, loops.Mesh] = WeakKeyDictionary()
_SKELETONS: WeakKeyDictionary[TemplateModel, _Skeleton] = WeakKeyDictionary()
_FITTED: WeakKeyDictionary[Correction, np.ndarray] = WeakKeyDictionary()
_SHAPED: WeakKeyDictionary[Surface, tuple[TemplateModel, bytes, np.ndarray]] = WeakKeyDictionary()
"""The last shape's rest vertices."""


def _mesh(surface: Surface) -> loops.Mesh:
    """The arrays of a surface as the loops read them, made once."""
    if surface not in _MESHES:
        v, m = len(surface.vertices), len(surface.morph_vertex)
        morph_row = np.full(v, -1, np.int32)
        morph_row[surface.morph_vertex] = np.arange(m)
        start, ring = rings(surface.faces, v)
        _MESHES[surface] = loops.Mesh(
            np.ascontiguousarray(surface.joint),
            np.ascontiguousarray(surface.weight),
            np.ascontiguousarray(surface.correction.group),
            np.ascontiguousarray(surface.correction.basis),
            morph_row,
            np.ascontiguousarray(np.concatenate([surface.morph, surface.morph_colour], 2).transpose(1, 0, 2)),
            start,
            ring,
        )
    return _MESHES[surface]


def _fitted(correction: Correction) -> Float64[np.ndarray, "n j 9"]:
    """The turns of its poses, made once."""
    if correction not in _FITTED:
        _FITTED[correction] = turns(correction.poses)
    return _FITTED[correction]


def rings(faces: np.ndarray, v: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each vertex's faces the two other corners in the face's order, by vertex and then by face: start (v + 1,), ring (3 f, 2)."""
    order = np.argsort(faces.ravel(), kind="stable")
    others = np.stack([np.roll(faces, -1, 1), np.roll(faces, -2, 1)], -1).reshape(-1, 2)
    start = np.concatenate([[0], np.cumsum(np.bincount(faces.ravel(), minlength=v))])
    return start.astype(np.int32), np.ascontiguousarray(others[order], np.int32)


def _skeleton(body: TemplateModel) -> _Skeleton:
    if body not in _SKELETONS:
        expression = None
        if body.joint_expression_dirs is not None:
            whole = body.joint_expression_dirs.double().cpu().numpy()
            expression = np.zeros_like(whole)
            turning = [JAW, LEFT_EYE, RIGHT_EYE]
            expression[turning] = whole[turning] - whole[HEAD]
        _SKELETONS[body] = _Skeleton(
            body.joint_template.double().cpu().numpy(),
            body.joint_shapedirs.double().cpu().numpy(),
            expression,
            np.array(body.parents),
            np.concatenate(tree_levels(body.parents)).astype(np.int64),
        )
    return _SKELETONS[body]


def _shaped(surface: Surface, body: TemplateModel, shape: np.ndarray) -> Float32[np.ndarray, "v 3"]:
    """p̄ + shape·β; the same array while β is."""
    key = shape.tobytes()
    known = _SHAPED.get(surface)
    if known is None or known[0] is not body or known[1] != key:
        _SHAPED[surface] = known = (body, key, _shaped_reference(surface, body, shape).astype(np.float32))
    return known[2]


def _shaped_reference(surface: Surface, body: TemplateModel, shape: np.ndarray) -> Float64[np.ndarray, "v 3"]:
    """Each vertex follows its template triangle's corners, by their barycentric weights."""
    used = _checked(shape, body.shapedirs.shape[2])
    rest = surface.vertices.astype(np.float64)
    if not shape.any():
        return rest
    follows = body.shapedirs[..., :used].double().cpu().numpy() @ shape[:used]
    corners = follows[body.faces.cpu().numpy()[surface.template_face]]
    return np.asarray(rest + np.einsum("vc,vcx->vx", surface.barycentric.astype(np.float64), corners))


def _checked(shape: np.ndarray, most: int) -> int:
    """How many coefficients are used. Raises `InputError` where one that the template does not have is not 0."""
    if shape[most:].any():
        raise InputError("template", "shape", f"at most {most} coefficients", len(shape))
    return min(most, len(shape))


def _square(transform: np.ndarray) -> Float64[np.ndarray, "j 4 4"]:
    bottom = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(transform), 1, 4))
    return np.concatenate([transform, bottom], 1)


def _posed_reference(surface: Surface, person: Person, signals: Signals, key: bytes) -> PosedSurface:
    """The equations of the module in float64."""
    skeleton, correction = _skeleton(person.body), surface.correction
    turn = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), signals.full_pose()[1:]])).as_matrix()
    joints = skeleton.joints(signals)
    transform, skinning = np.zeros((2, len(joints), 4, 4))
    for j in skeleton.order:
        local, above = np.eye(4), skeleton.parents[j]
        local[:3, :3] = turn[j]
        local[:3, 3] = joints[j] - (joints[above] if above >= 0 else 0)
        transform[j] = local if above < 0 else transform[above] @ local
        skinning[j] = transform[j]
        skinning[j, :3, 3] -= transform[j, :3, :3] @ joints[j]
    own, fitted = turns(signals.full_pose()[None]), turns(correction.poses)
    near = zip(correction.joints, correction.closeness)
    kernel = np.stack([pose_kernel(own, fitted, *row)[0] for row in near])
    amount = np.einsum("gn,gnr->gr", kernel, correction.weights.astype(np.float64))
    amount = np.clip(amount, correction.low, correction.high)
    change = np.einsum("vrc,vr->vc", correction.basis, amount[correction.group])
    expression = signals.expression[: len(surface.morph)]
    morph = np.concatenate([surface.morph, surface.morph_colour], 2)
    change[surface.morph_vertex] += np.einsum("emc,e->mc", morph, expression)
    rest = _shaped_reference(surface, person.body, signals.shape)
    blend = np.einsum("vk,vkab->vab", surface.weight, skinning[surface.joint])
    vertices = np.einsum("vab,vb->va", blend[:, :3, :3], rest + change[:, :3]) + blend[:, :3, 3]
    normals = np.zeros_like(vertices)
    for corner in range(3):
        at, b, c = (vertices[surface.faces[:, (corner + i) % 3]] for i in range(3))
        np.add.at(normals, surface.faces[:, corner], np.cross(b - at, c - at))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    state = loops.State(rest.astype(np.float32), np.ascontiguousarray(skinning[:, :3]), amount, expression)
    placed, turned, tint = (np.ascontiguousarray(value, np.float32) for value in (vertices, normals, change[:, 3:]))
    return PosedSurface(surface, person, placed, turned, tint, transform, key, state)
