"""The clothed subject's solids: garments as level sets over the body (drape.py), eyes, teeth and tongue closed by caps.

Letters: v vertices, p points. T-pose, root frame, metres, float64.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drape
import numpy as np
import trimesh
from drape import Field, Loft, hang, loft, smooth_max, smooth_min
from subject_body import Body, X, Y, Z, smoothstep

from avatarrex.capture.synthetic.subject import FACE_SOLIDS
from avatarrex.capture.synthetic.texture import value_noise

CLOTH_STEP, TUNIC_STEP, SHOE_STEP, HAIR_STEP = 0.0085, 0.0095, 0.0055, 0.0038
"""Metres between marching-cubes samples: folds of 3 cm need 4 vertices."""
CLOTH = 0.004
"""Metres, thickness of a hem."""
DOWN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Rows: section axes to the left and to the front, then the loft's axis, down."""


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
    crotch = body.crotch
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
    armpit, hem = body.armpit, body.crotch + 0.045

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
    armpit, hem = body.armpit, knee[Y] + 0.045

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
    joints, cloud, armpit = body.joints, body.cloud, body.armpit
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
        ramp = smoothstep(above / 0.03)
        thick = 0.0035 + ramp * (0.0045 + 0.014 * up**1.5 + 0.008 * front * up)
        comb = np.column_stack([p[:, X] + 0.25 * p[:, Z], 0.22 * p[:, Y], 0.22 * p[:, Z]])
        locks = np.abs(value_noise(comb, 0.011)) + 0.4 * np.abs(value_noise(comb, 0.006))
        return smooth_max(body.distance(p) - thick - ramp * 0.0042 * locks, -0.9 * above, 0.005)

    low, high = np.array([-0.11, head[Y] - 0.07, -0.15]), np.array([0.11, top + 0.06, 0.19])
    vertices, faces = drape.extract(solid, low, high, HAIR_STEP, 6)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh = max(mesh.split(only_watertight=True), key=lambda part: part.volume)
    return Piece("hair", 4, np.asarray(mesh.vertices), np.asarray(mesh.faces), lambda p: line(p) + 0.012 - p[:, Y])


def inner_parts(body: Body) -> list[Piece]:
    """Eyes, teeth and tongue; open loops are closed by a fan."""
    pieces = []
    for name in FACE_SOLIDS:
        index = np.full(len(body.model.v_template), -1)
        vertices = body.group(name)
        index[body.model.groups[name].numpy()] = np.arange(len(vertices))
        faces = index[body.model.faces.numpy()]
        faces = faces[(faces >= 0).all(1)]
        for ring in drape.loops(faces):
            fan = np.stack([np.roll(ring, -1), ring, np.full(len(ring), len(vertices))], 1)
            vertices = np.concatenate([vertices, vertices[ring].mean(0, keepdims=True)])
            faces = np.concatenate([faces, fan])
        pieces.append(Piece(name, 0, vertices, faces))
    return pieces
