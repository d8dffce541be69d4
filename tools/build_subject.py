"""Make the clothed subject's solids: `avatarrex/data/subject.npz` from `avatarrex/data/person.npz`.

    python tools/build_subject.py            (needs the extra `sdf`; about two minutes)
    python tools/build_subject.py loose      (`subject_loose.npz`: a wide tunic instead of the T-shirt)

The pattern: a T-shirt, trousers, two shoes and a short haircut as level sets over the default person
(capture/synthetic/drape.py), teeth closed by caps, and the skin under cloth pushed inwards. Each solid is bound to the body:
smoothed skin weights, and a nearest body triangle for shape, expression and pose offsets. Ambient occlusion is baked
in an A-pose.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import igl
import numpy as np
import scipy.sparse as sp
import trimesh
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from avatarrex.capture.synthetic import drape
from avatarrex.capture.synthetic.drape import Field, Loft, hang, loft, smooth_max, smooth_min
from avatarrex.capture.synthetic.mesh import averaging, smoothed, vertex_normals
from avatarrex.capture.synthetic.subject import PACKAGED, Subject, load_subject
from avatarrex.capture.synthetic.texture import value_noise
from avatarrex.files.assets import DATA, read_arrays
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.person import Person, load_person

PERSON = DATA / "person.npz"
CLOTH_STEP, TUNIC_STEP, SHOE_STEP, HAIR_STEP = 0.0085, 0.0095, 0.0055, 0.0038
"""Metres between marching-cubes samples: folds of 3 cm need 4 vertices."""
MOUTH_OPENNESS = 0.55
"""Least openness inside the mouth, which is baked shut but seen open."""
CLOTH = 0.004
"""Metres, thickness of a hem."""
TUCK = 0.014
"""Metres that covered skin is pushed in, so that it stays inside when joints bend."""
WALL = 0.013
"""Metres that the mouth's lining stands off the skin behind it: lips and cheeks are otherwise shells of 3 mm."""
CROWN = 0.007
"""Metres of a tooth that the lining leaves bare."""
DOWN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
X, Y, Z = 0, 1, 2


@dataclass
class Body:
    """The default person's body group at rest, with a dense cloud of surface points by dominant joint."""

    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    joints: dict[str, np.ndarray]
    distance: Field
    cloud: np.ndarray = field(init=False)
    cloud_weights: np.ndarray = field(init=False)
    names: list[str] = field(init=False)
    arms: np.ndarray = field(init=False)
    """Summed skin weight of both arms at the cloud's points."""

    def __post_init__(self) -> None:
        steps = [(i, j, 5 - i - j) for i in range(6) for j in range(6 - i)]
        bary = np.array(steps) / 5
        self.cloud = np.einsum("sk,fkc->fsc", bary, self.vertices[self.faces]).reshape(-1, 3)
        self.cloud_weights = np.einsum("sk,fkj->fsj", bary, self.weights[self.faces]).reshape(len(self.cloud), -1)
        self.names = list(self.joints)
        arm = ("shoulder", "elbow", "wrist", "index", "thumb")
        self.arms = self.share(*(name for name in self.names if any(part in name for part in arm)))

    def share(self, *names: str) -> np.ndarray:
        """Summed skin weight of the named joints at the cloud's points."""
        return self.cloud_weights[:, [self.names.index(name) for name in names]].sum(1)


@dataclass
class Piece:
    """One solid before it is bound."""

    name: str
    smoothing: int
    """Rounds of weight averaging; 0 where it is the template's own."""
    vertices: np.ndarray
    faces: np.ndarray
    covers: Field | None = None
    """Negative where the skin below is certainly covered, metres from an opening."""
    cloth: int = 0
    """The first so many vertices are cloth with open hems; the rest are turned-in hems and caps."""


@dataclass(frozen=True)
class Top:
    """How an upper garment is cut. Metres, T-pose."""

    hem: float
    """y of the hem; `wave` lower in front and at the back, higher at the sides."""
    wave: float
    end: float
    """|x| where the sleeves end."""
    trunk: tuple[float, float, float]
    """Ease at the top, at the hem, and taper (`drape.hang`)."""
    sleeve: tuple[float, float, float]
    """Ease at the shoulder, at the end, and taper."""
    standoff: float
    """Off the skin of the shoulders."""
    blends: tuple[float, float]
    """Of the smooth unions with the shoulders and with the sleeves."""
    folded: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """The field (p,) with folds, from the field without and the points (p, 3)."""
    depth: tuple[float, float]
    """z of the box that it is extracted in."""
    step: float
    """Between marching-cubes samples."""
    lining: float
    """How far up the inside hem and cuffs are closed."""


def read_body() -> tuple[Body, Person]:
    """The body group of the packaged person, float64."""
    person = load_person()
    model = person.body.double()
    ids = model.groups["body"].numpy()
    if not np.array_equal(ids, np.arange(len(ids))):
        raise SystemExit("the body group must come first in person.npz")
    vertices, faces = model.v_template.numpy()[ids], model.faces.numpy()
    faces = faces[(faces < len(ids)).all(1)]
    joints = dict(zip(model.joint_names, model.joint_template.numpy()))
    body = Body(vertices, faces, model.weights.numpy()[ids], joints, drape.mesh_distance(vertices, faces))
    return body, person


def sewn(
    solid: Field, level: Field, box: tuple[list[float], list[float]], step: float, depth: Callable[[np.ndarray], float]
) -> tuple[np.ndarray, np.ndarray, Field, int]:
    """A garment's vertices, faces, `level` and number of cloth vertices: the zero level of `solid`, cut at `level`, hemmed."""
    vertices, faces = drape.extract(solid, np.array(box[0]), np.array(box[1]), step)
    vertices, faces = drape.cut(vertices, faces, level, step)
    return *drape.close_hems(vertices, faces, level, CLOTH, depth), level, len(vertices)


def trousers(body: Body) -> Piece:
    """Straight trousers: two hanging lofts, a hip loft, and the offset body between them."""
    joints = body.joints
    ankle = joints["left_ankle"][Y]
    crotch = _crotch(body)
    legs: list[Field] = []
    for name, side in (("left", 1), ("right", -1)):
        own = (body.share(f"{name}_hip", f"{name}_knee", f"{name}_ankle") > 0.4) & (side * body.cloud[:, X] > 0.002)
        own &= body.cloud[:, Y] > ankle - 0.01
        hip, foot = joints[f"{name}_hip"], joints[f"{name}_ankle"]
        axis = (foot - hip) / np.linalg.norm(foot - hip)
        across = np.cross([0, 0, 1.0], axis)
        across /= np.linalg.norm(across)
        frame = np.array([across, np.cross(axis, across), axis])
        section = loft(body.cloud[own], hip, frame, hip[Y] - crotch - 0.02, hip[Y] - ankle + 0.06)
        legs.append(hang(section, 0.008, 0.07))
    hips = body.cloud[(body.arms < 0.3) & (body.cloud[:, Y] < 0.16) & (body.cloud[:, Y] > crotch)]
    seat = hang(loft(hips, np.zeros(3), DOWN, -0.15, -crotch), 0.007, 1.0)

    def solid(p: np.ndarray) -> np.ndarray:
        pelvis = smooth_max(seat(p), crotch + 0.035 - p[:, Y], 0.05)
        low = [smooth_max(leg(p), p[:, Y] - crotch - 0.01, 0.04) for leg in legs]
        cloth = smooth_min(smooth_min(low[0], low[1], 0.03), pelvis, 0.05)
        cloth = smooth_min(cloth, body.distance(p) - 0.006, 0.015)
        stack = np.exp(-(((p[:, Y] - ankle - 0.075) / 0.04) ** 2))
        bunch = np.sin(2 * np.pi * (p[:, Y] + 0.25 * p[:, Z] * np.sign(p[:, X])) / 0.042 + 2 * value_noise(p, 0.07))
        return cloth - stack * 0.0035 * (1 + bunch)

    def level(p: np.ndarray) -> np.ndarray:
        return np.maximum(p[:, Y] - 0.075, ankle - 0.008 + 0.10 * (p[:, Z] - joints["left_ankle"][Z]) - p[:, Y])

    box = ([-0.32, ankle - 0.05, -0.21], [0.32, 0.10, 0.24])
    return Piece("trousers", 30, *sewn(solid, level, box, CLOTH_STEP, lambda c: 0.02 if c[Y] < -0.5 else 0.004))


def shirt(body: Body, below: Piece) -> Piece:
    """A loose T-shirt: a torso loft that hangs from the chest, two sleeves that widen, and the offset shoulders."""
    shoulder, elbow = body.joints["left_shoulder"], body.joints["left_elbow"]
    armpit, hem = _armpit(body), _crotch(body) + 0.045

    def folded(cloth: np.ndarray, p: np.ndarray) -> np.ndarray:
        around = np.arctan2(p[:, X], p[:, Z])
        low = np.clip((armpit - 0.16 - p[:, Y]) / 0.3, 0, 1)
        flute = np.sin(9 * around + 2.2 * value_noise(p * [1, 0.35, 1], 0.12)) * (0.6 + 0.4 * value_noise(p, 0.2))
        drag = np.sin(2 * np.pi * (p[:, Y] - 0.7 * p[:, X] * np.tanh(20 * p[:, X])) / 0.075 + 5 * value_noise(p, 0.13))
        return cloth - 0.006 * low * flute - 0.0014 * drag * np.exp(-(((p[:, Y] - armpit + 0.1) / 0.12) ** 2))

    cut = Top(
        hem=hem, wave=0.012, end=shoulder[X] + 0.60 * (elbow[X] - shoulder[X]), trunk=(0.009, 0.009, 0.10),
        sleeve=(0.010, 0.017, 0.02), standoff=0.009, blends=(0.035, 0.045), folded=folded, depth=(-0.2, 0.24),
        step=CLOTH_STEP, lining=0.016,
    )  # fmt: skip
    return Piece("shirt", 30, *top(body, cut, below.vertices[below.vertices[:, Y] > hem - 0.05]))


def tunic(body: Body) -> Piece:
    """A wide tunic to above the knee: one flared trunk over both thighs, bell sleeves, deep flutes.

    Its topology is not the body's (one tube about two legs), and it stands off the skin by up to a decimetre.
    """
    shoulder, elbow, wrist, knee = (body.joints[f"left_{name}"] for name in ("shoulder", "elbow", "wrist", "knee"))
    armpit, hem = _armpit(body), knee[Y] + 0.045

    def folded(cloth: np.ndarray, p: np.ndarray) -> np.ndarray:
        around = np.arctan2(p[:, X], p[:, Z])
        low = np.clip((armpit - 0.12 - p[:, Y]) / (armpit - 0.12 - hem), 0, 1)
        flute = np.sin(12 * around + 1.6 * value_noise(p * [1, 0.3, 1], 0.16)) * (0.7 + 0.3 * value_noise(p, 0.25))
        turn = np.arctan2(p[:, Y] - shoulder[Y], p[:, Z] - shoulder[Z])
        far = np.clip((np.abs(p[:, X]) - elbow[X] + 0.10) / 0.2, 0, 1) * (p[:, Y] > armpit - 0.05)
        bell = np.sin(5 * turn + 2 * value_noise(p, 0.1))
        return cloth - 0.014 * low**1.3 * flute - 0.005 * far * bell

    cut = Top(
        hem=hem, wave=0.014, end=elbow[X] + 0.72 * (wrist[X] - elbow[X]), trunk=(0.014, 0.030, -0.11),
        sleeve=(0.018, 0.034, -0.03), standoff=0.012, blends=(0.045, 0.075), folded=folded, depth=(-0.36, 0.40),
        step=TUNIC_STEP, lining=0.030,
    )  # fmt: skip
    return Piece("tunic", 130, *top(body, cut, body.cloud[:0]))


def top(body: Body, cut: Top, inner: np.ndarray) -> tuple[np.ndarray, np.ndarray, Field, int]:
    """An upper garment, `sewn`: a trunk that also hangs over the points `inner` (p, 3), two sleeves, offset shoulders."""
    joints, cloud, armpit = body.joints, body.cloud, _armpit(body)
    shoulder, neck = joints["left_shoulder"], joints["neck"]
    below = (cloud[:, Y] < shoulder[Y] - 0.02) & (cloud[:, Y] > cut.hem - 0.05)
    torso = cloud[(body.arms < 0.35) & below & (np.abs(cloud[:, X]) < 0.3)]
    section = loft(np.concatenate([torso, inner]), np.zeros(3), DOWN, -armpit, -cut.hem + 0.04)
    trunk = hang(section, np.linspace(*cut.trunk[:2], len(section.t)), cut.trunk[2])
    sleeves: list[Loft] = []
    for name, side in (("left", 1), ("right", -1)):
        outer = side * cloud[:, X]
        own = body.share(f"{name}_shoulder", f"{name}_elbow", f"{name}_wrist") > 0.5
        own &= (outer > shoulder[X]) & (outer < joints["left_wrist"][X])
        frame = np.array([[0, 1.0, 0], [0, 0, 1.0], [side, 0, 0]])
        arm = loft(cloud[own], np.zeros(3), frame, shoulder[X] + 0.02, cut.end + 0.03)
        sleeves.append(hang(arm, np.linspace(*cut.sleeve[:2], len(arm.t)), cut.sleeve[2]))

    def solid(p: np.ndarray) -> np.ndarray:
        cloth = smooth_max(trunk(p), p[:, Y] - armpit, 0.06)
        cloth = smooth_min(cloth, body.distance(p) - cut.standoff, cut.blends[0])
        for side, sleeve in zip((1, -1), sleeves):
            arm = smooth_max(sleeve(p), shoulder[X] + 0.03 - side * p[:, X], 0.05)
            cloth = smooth_min(cloth, arm, cut.blends[1])
        return cut.folded(cloth, p)

    def level(p: np.ndarray) -> np.ndarray:
        ring = np.hypot(p[:, X] / 0.086, (p[:, Z] - neck[Z] - 0.012) / 0.066)
        collar = (p[:, Y] - neck[Y] + 0.032 + 0.45 * p[:, Z] - 0.085 * (ring - 1)) * 0.7
        bottom = cut.hem - cut.wave * np.cos(2 * np.arctan2(p[:, X], p[:, Z])) - p[:, Y]
        return np.maximum(np.maximum(np.abs(p[:, X]) - cut.end, bottom), collar)

    box = ([-cut.end - 0.02, cut.hem - 0.04, cut.depth[0]], [cut.end + 0.02, neck[Y] + 0.07, cut.depth[1]])
    return sewn(solid, level, box, cut.step, lambda c: 0.010 if c[Y] > 0.5 else cut.lining)


def shoe(body: Body, side: float) -> Piece:
    """A sneaker: hull slices along the foot, an ankle collar and a flat sole."""
    name = "left" if side > 0 else "right"
    ankle = body.joints[f"{name}_ankle"]
    cloud = body.cloud[(side * body.cloud[:, X] > 0) & (body.cloud[:, Y] < ankle[Y] + 0.08)]
    floor = cloud[:, Y].min()
    foot = cloud[cloud[:, Y] < ankle[Y] + 0.005]
    heel, toe = foot[:, Z].min(), foot[:, Z].max()
    upper = hang(loft(foot, np.zeros(3), np.eye(3), heel, toe, 0.008), 0.006, 2.0)
    shin = cloud[cloud[:, Y] > ankle[Y] - 0.05]
    collar = hang(loft(shin, np.zeros(3), DOWN, -ankle[Y] - 0.07, -ankle[Y] + 0.05), 0.006, 2.0)
    print_points = np.column_stack([foot[:, X], np.zeros(len(foot)), foot[:, Z]])[foot[:, Y] < floor + 0.05]
    footprint = hang(loft(print_points, np.zeros(3), DOWN, -0.02, 0.02), 0.007, 1.0, (0.5, 1.5))

    def solid(p: np.ndarray) -> np.ndarray:
        body_of_shoe = smooth_max(upper(p), np.maximum(p[:, Z] - toe - 0.004, heel - 0.008 - p[:, Z]), 0.035)
        body_of_shoe = smooth_max(body_of_shoe, p[:, Y] - ankle[Y], 0.02)
        shaft = np.maximum(collar(p), np.maximum(p[:, Y] - ankle[Y] - 0.028, ankle[Y] - 0.05 - p[:, Y]))
        cloth = smooth_min(body_of_shoe, smooth_max(shaft, shaft, 0.01), 0.03)
        flat = p * [1, 0, 1]
        rise = 0.010 * np.clip((p[:, Z] - toe + 0.05) / 0.05, 0, 1) ** 2
        slab = smooth_max(footprint(flat), np.abs(p[:, Y] - floor + 0.002 - rise) - 0.017, 0.008)
        return smooth_min(cloth, slab, 0.007)

    low = np.array([cloud[:, X].min() - 0.04, floor - 0.035, heel - 0.04])
    high = np.array([cloud[:, X].max() + 0.04, ankle[Y] + 0.05, toe + 0.04])
    return Piece(f"{name}_shoe", 8, *drape.extract(solid, low, high, SHOE_STEP, 8), lambda p: p[:, Y] - ankle[Y] - 0.02)


def hair(body: Body) -> Piece:
    """A short cut: the head's offset above a hairline, fuller on top, in combed locks."""
    head = body.joints["head"]
    eye = body.joints["left_eye"]
    top = body.vertices[:, Y].max()
    scale = (top - eye[Y]) / 0.113
    centre = np.array([0, eye[Y] + 0.03 * scale, head[Z]])

    def line(p: np.ndarray) -> np.ndarray:
        """Lowest y of hair at each z, from nape to forehead; sideburns before the ear, a hollow above it."""
        z = [-0.08, -0.03, 0.0, 0.010, 0.018, 0.024, 0.046, 0.052, 0.055, 0.064, 0.070, 0.085, 0.10, 0.115, 0.14]
        y = [-0.064, -0.06, -0.046, -0.028, 0.006, 0.017, 0.018, 0.012, -0.02, -0.018, 0.012, 0.046, 0.06, 0.066, 0.067]
        wobble = 0.0025 * value_noise(p, 0.012)
        peak = 0.003 * np.cos(np.clip(np.abs(p[:, X]) / 0.035, 0, 1) * np.pi) * (p[:, Z] > 0.09)
        return eye[Y] + scale * np.interp(p[:, Z], z, y) + wobble - peak

    def solid(p: np.ndarray) -> np.ndarray:
        above = p[:, Y] - line(p)
        out = p - centre
        up = np.clip(out[:, Y] / np.linalg.norm(out, axis=1), 0, 1)
        front = np.clip((p[:, Z] - 0.02) / 0.1, 0, 1)
        ramp = _smoothstep(above / 0.03)
        thick = 0.0035 + ramp * (0.0045 + 0.014 * up**1.5 + 0.008 * front * up)
        comb = np.column_stack([p[:, X] + 0.25 * p[:, Z], 0.22 * p[:, Y], 0.22 * p[:, Z]])
        locks = np.abs(value_noise(comb, 0.011)) + 0.4 * np.abs(value_noise(comb, 0.006))
        return smooth_max(body.distance(p) - thick - ramp * 0.0042 * locks, -0.9 * above, 0.005)

    low, high = np.array([-0.11, head[Y] - 0.07, -0.15]), np.array([0.11, top + 0.06, 0.19])
    vertices, faces = drape.extract(solid, low, high, HAIR_STEP, 6)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh = max(mesh.split(only_watertight=True), key=lambda part: part.volume)
    return Piece("hair", 4, np.asarray(mesh.vertices), np.asarray(mesh.faces), lambda p: line(p) + 0.012 - p[:, Y])


def inner_parts(person: Person) -> list[Piece]:
    """Eyes, teeth and tongue; open loops are closed by a fan."""
    model = person.body.double()
    pieces = []
    for name in ("left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue"):
        ids = model.groups[name].numpy()
        index = np.full(len(model.v_template), -1)
        index[ids] = np.arange(len(ids))
        faces = index[model.faces.numpy()]
        faces = faces[(faces >= 0).all(1)]
        vertices = model.v_template.numpy()[ids]
        for ring in drape.loops(faces):
            fan = np.stack([np.roll(ring, -1), ring, np.full(len(ring), len(vertices))], 1)
            vertices = np.concatenate([vertices, vertices[ring].mean(0, keepdims=True)])
            faces = np.concatenate([faces, fan])
        pieces.append(Piece(name, 0, vertices, faces))
    return pieces


def tuck(body: Body, pieces: list[Piece]) -> np.ndarray:
    """Offsets (v, 3) that push covered skin inwards, growing over 3 cm from each opening."""
    normal = vertex_normals(body.vertices, body.faces)
    covered = np.zeros(len(body.vertices))
    for piece in pieces:
        if piece.covers is None:
            continue
        inside = igl.fast_winding_number(piece.vertices, piece.faces, body.vertices) > 0.5
        covered = np.maximum(covered, np.where(inside, np.clip((-piece.covers(body.vertices) - 0.02) / 0.03, 0, 1), 0))
    soft = smoothed(averaging(body.faces, len(normal)), normal, 6, 0)
    return -TUCK * _smoothstep(covered)[:, None] * soft


def line_mouth(body: Body, person: Person, lip: np.ndarray) -> np.ndarray:
    """Offsets (v, 3) that bring the mouth's lining forward as gums and cheeks, up to the bare crowns and the tongue.

    `lip` (v,): metres from the mouth's rim, negative inside. The lining keeps its own skinning and expressions, so it
    never comes through the lips.
    """
    model = person.body.double()
    upper, lower, tongue = (
        model.v_template.numpy()[model.groups[n].numpy()] for n in ("upper_teeth", "lower_teeth", "tongue")
    )
    meet = (upper[:, Y].min() + lower[:, Y].max()) / 2
    crowns = np.concatenate([upper, lower])
    bare = np.concatenate([crowns[np.abs(crowns[:, Y] - meet) < CROWN], tongue])
    mean = averaging(body.faces, len(body.vertices))
    normal = smoothed(mean, vertex_normals(body.vertices, body.faces), 2)
    depth = _smoothstep((-lip - 0.001) / 0.007)
    free = cKDTree(bare).query(body.vertices)[0] - 0.001
    amount = depth * np.clip(free, 0, WALL)
    for _ in range(2):
        amount = np.where(depth > 0, np.minimum(amount, smoothed(mean, amount, 1)), 0)
    return amount[:, None] * normal


def bind(piece: Piece, model: TemplateModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed skin weights (v, 55), nearest template face (v,) and barycentrics (v, 3) there."""
    vertices, faces = model.v_template.numpy(), model.faces.numpy()
    skin = (faces < len(model.groups["body"])).all(1)
    wanted = np.flatnonzero(skin) if piece.smoothing else np.arange(len(faces))
    _, face, nearest = igl.point_mesh_squared_distance(piece.vertices, vertices, faces[wanted])
    face = wanted[np.asarray(face).ravel()]
    bary = trimesh.triangles.points_to_barycentric(vertices[faces[face]], np.asarray(nearest))
    bary = np.clip(np.nan_to_num(bary, nan=1 / 3), 0, 1)
    bary /= bary.sum(1, keepdims=True)
    own = np.einsum("vk,vkj->vj", bary, model.weights.numpy()[faces[face]])
    return smoothed(averaging(piece.faces, len(own)), own, piece.smoothing, 0.4), face, bary


def masks(body: Body, pieces: list[Piece]) -> dict[str, np.ndarray]:
    """Per-vertex numbers for the texture, body first.

    `lip` and `lid`: metres from the rim of the mouth and of the eyelids, negative inside the cavity. `edge`: metres
    from the nearest cut of a garment. `nail_u`, `nail_v`: coordinates on the nail (unit circle), far away elsewhere.
    `interior`: 1 on cloth, falling to 0 at hems.
    """
    arrays = read_arrays(PERSON)
    chart, charts = _charts(arrays["ft"].astype(np.int64))
    faces = arrays["f"].astype(np.int64)
    n = len(body.vertices)
    total = n + sum(len(piece.vertices) for piece in pieces)
    out = {name: np.full(total, 0.03) for name in ("lip", "lid")}
    out.update({name: np.full(total, 9.0) for name in ("nail_u", "nail_v")})
    out.update(edge=np.full(total, 0.2), interior=np.zeros(total))
    for c in range(charts):
        own = faces[chart == c]
        if own.max() >= n:
            continue
        other = faces[(chart != c) & (faces.max(1) < n)]
        rim = np.intersect1d(own, other)
        size = body.vertices[np.unique(own)].max(0) - body.vertices[np.unique(own)].min(0)
        centre = body.vertices[np.unique(own)].mean(0)
        if size.max() > 0.12 or not (centre[Y] > body.joints["neck"][Y]):
            continue
        name = "lip" if abs(centre[X]) < 0.005 else "lid"
        loop = _ring_points(own, other, body.vertices)
        distance = cKDTree(loop).query(body.vertices)[0]
        inside = np.setdiff1d(np.unique(own), rim)
        distance[inside] *= -1
        out[name][:n] = np.where(
            np.abs(distance) < np.abs(out[name][:n]), np.clip(distance, -0.03, 0.03), out[name][:n]
        )
    _nails(body, out)
    start = n
    for piece in pieces:
        stop = start + len(piece.vertices)
        if piece.cloth:
            level = -piece.covers(piece.vertices[: piece.cloth])
            out["edge"][start:stop] = 0
            out["edge"][start : start + piece.cloth] = np.clip(level, 0, 0.2)
            out["interior"][start : start + piece.cloth] = np.clip(level / 0.025, 0, 1)
        start = stop
    return out


def _charts(ft: np.ndarray) -> tuple[np.ndarray, int]:
    """UV chart of every face, and how many there are."""
    edges = np.concatenate([ft[:, :2], ft[:, 1:]])
    size = ft.max() + 1
    _, label = connected_components(sp.coo_matrix((np.ones(len(edges)), edges.T), (size, size)))
    _, chart = np.unique(label[ft[:, 0]], return_inverse=True)
    return chart, int(chart.max()) + 1


def _ring_points(own: np.ndarray, other: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Dense points on the edges that two face sets share."""

    def edges(faces: np.ndarray) -> set[tuple[int, int]]:
        pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
        return set(map(tuple, pairs.tolist()))

    shared = np.array(sorted(edges(own) & edges(other)))
    s = np.linspace(0, 1, 12)[:, None, None]
    return (vertices[shared[:, 0]] * (1 - s) + vertices[shared[:, 1]] * s).reshape(-1, 3)


def _nails(body: Body, out: dict[str, np.ndarray]) -> None:
    """Nail coordinates on the last 16 mm of each finger's back."""
    normal = vertex_normals(body.vertices, body.faces)
    for side in ("left", "right"):
        for finger in ("index", "middle", "ring", "pinky", "thumb"):
            column = body.names.index(f"{side}_{finger}3")
            own = np.flatnonzero(body.weights[:, column] > 0.5)
            joint, before = body.joints[f"{side}_{finger}3"], body.joints[f"{side}_{finger}2"]
            along = (joint - before) / np.linalg.norm(joint - before)
            reach = (body.vertices[own] - joint) @ along
            tip = reach.max()
            up = np.array([0, 1.0, 0]) if finger != "thumb" else np.array([0, 0.75, 0.66])
            up = up - along * (up @ along)
            up /= np.linalg.norm(up)
            across = np.cross(along, up)
            middle = np.median((body.vertices[own] - joint) @ across)
            long, wide = (0.0068, 0.0056) if finger == "thumb" else (0.0060, 0.0047 if finger != "pinky" else 0.0040)
            back = own[normal[own] @ up > 0.0]
            local = body.vertices[back] - joint
            out["nail_u"][back] = (local @ along - (tip - long * 1.05)) / long
            out["nail_v"][back] = (local @ across - middle) / wide


def bake_openness(subject: Subject) -> np.ndarray:
    """(v,) uint8: 255 · (1 − ambient occlusion) with the arms lowered halfway and the legs apart."""
    pose = np.zeros((55, 3))
    for name, angle in (("left_shoulder", -0.7), ("right_shoulder", 0.7), ("left_hip", 0.12), ("right_hip", -0.12)):
        pose[subject.model.joint_names.index(name), Z] = angle
    posed = subject.pose(Signals.from_full_pose(pose))
    faces = np.ascontiguousarray(posed.faces[posed.solids.outer])
    lifted = posed.vertices + 1.5e-3 * posed.normals
    occlusion = np.asarray(igl.ambient_occlusion(posed.vertices, faces, lifted, posed.normals, 160)).ravel()
    occlusion = smoothed(averaging(posed.faces, len(occlusion)), occlusion, 2)
    shown = np.isin(np.array(subject.names)[subject.solid_of_vertex], ("upper_teeth", "lower_teeth", "tongue"))
    openness = np.maximum(1 - occlusion, np.where(shown | (subject.masks["lip"] < 0), MOUTH_OPENNESS, 0))
    return np.round(255 * np.clip(openness, 0, 1)).astype(np.uint8)


def _crotch(body: Body) -> float:
    """y of the lowest skin near the middle between the legs."""
    near = (np.abs(body.cloud[:, X]) < 0.01) & (body.cloud[:, Y] < 0.1) & (body.cloud[:, Y] > -0.3)
    return float(body.cloud[near, Y].min())


def _armpit(body: Body) -> float:
    """y of the lowest skin under the shoulder joint's inner side."""
    x = body.joints["left_shoulder"][X]
    near = (np.abs(body.cloud[:, X] - x - 0.045) < 0.015) & (body.share("left_shoulder", "left_collar", "spine3") > 0.8)
    return float(np.quantile(body.cloud[near, Y], 0.02)) - 0.02


def follow(upper: Piece, own: np.ndarray, lower: Piece, lower_weights: np.ndarray) -> np.ndarray:
    """Skin weights (v, 55) of the shirt that go over, below the waist, to those of the trousers it hangs on.

    Cloth that lies on other cloth must bend like it: with the pelvis' weights the front hem cuts through a squat's groin.
    """
    _, near = cKDTree(lower.vertices[: lower.cloth]).query(upper.vertices, k=4)
    ramp = np.clip((0.07 - upper.vertices[:, Y]) / 0.08, 0, 1)[:, None]
    mixed = own + (lower_weights[near].mean(1) - own) * ramp * ramp * (3 - 2 * ramp)
    return smoothed(averaging(upper.faces, len(mixed)), mixed, 6, 0.4)


def packed(pieces: list[Piece], model: TemplateModel, garment: str) -> dict[str, np.ndarray]:
    """The solids' own arrays, as `assets_spec/subject.json` names them; each solid is reported on a line."""
    for piece in pieces:
        mesh = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
        closed = "closed" if mesh.is_watertight else "OPEN"
        print(f"{piece.name}: {len(mesh.vertices)} v, {len(mesh.faces)} f, {1e3 * mesh.volume:.2f} l, {closed}")
    bound, face, bary = map(list, zip(*(bind(piece, model) for piece in pieces)))
    if garment == "default":
        bound[0] = follow(pieces[0], bound[0], pieces[1], bound[1])
    weights = np.concatenate(bound)
    top = np.argsort(-weights, axis=1)[:, :6]
    strongest = np.take_along_axis(weights, top, 1)
    strongest /= strongest.sum(1, keepdims=True)
    return {
        "names": np.array([piece.name for piece in pieces]),
        "vertex_count": np.array([len(piece.vertices) for piece in pieces]),
        "face_count": np.array([len(piece.faces) for piece in pieces]),
        "vertices": np.concatenate([piece.vertices for piece in pieces]).astype(np.float32),
        "faces": np.concatenate([piece.faces for piece in pieces]).astype(np.uint16),
        "weight_joint": top.astype(np.uint8),
        "weight": np.round(strongest * 65535).astype(np.uint16),
        "bind_face": np.concatenate(face).astype(np.uint16),
        "bind_bary": np.round(np.concatenate(bary) * 65535).astype(np.uint16),
    }


def _smoothstep(t: np.ndarray) -> np.ndarray:
    """3t² − 2t³ within [0, 1]."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def main(garment: str = "default", out: str = "") -> None:
    path = Path(out) if out else DATA / PACKAGED[garment]
    started = time.time()
    body, person = read_body()
    print(f"crotch {_crotch(body):.3f}, armpit {_armpit(body):.3f}")
    below = trousers(body)
    upper = tunic(body) if garment == "loose" else shirt(body, below)
    pieces = [upper, below, shoe(body, 1), shoe(body, -1), hair(body), *inner_parts(person)]
    print(f"shapes {time.time() - started:.0f} s")
    arrays = packed(pieces, person.body.double(), garment)
    painted = masks(body, pieces)
    lining = line_mouth(body, person, painted["lip"][: len(body.vertices)])
    arrays["tuck"] = (tuck(body, pieces) + lining).astype(np.float16)
    arrays["person_hash"] = np.array(person.hash)
    arrays["measures"] = np.array([_crotch(body), _armpit(body)])
    arrays |= {f"mask_{name}": mask.astype(np.float16) for name, mask in painted.items()}
    arrays["openness"] = np.full(len(body.vertices) + len(arrays["vertices"]), 255, np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        first = Path(folder) / "unlit.npz"
        np.savez(first, allow_pickle=False, **arrays)
        arrays["openness"] = bake_openness(load_subject(str(first)))
    np.savez_compressed(path, allow_pickle=False, **arrays)
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB, {time.time() - started:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
