"""Another person in the default subject's clothes: own face, hands, build and colouring, own expression shapes.

    x' = x + D(x)        directions' = (I + ∂D/∂x) directions        E'_k = E_k + P_k,  |P_k| = d_k |E_k|,  d_k ∈ [0.1, 0.3]

D is smooth on the whole rest space and moves all solids and joints alike, so that layers stay in their order: bulges
(skull, jaw, nose, brows, ears, lips), longer legs, shorter arms, a wider trunk and palm, and noise of 6 cm that no shape
direction of the template has and that knows no left and right. About each eye it is a similarity: eyeballs stay round and lids
stay on them. Fingers are thicker, with knuckles, about their own bones. The texture is read where it was painted
(`Subject.pattern`). P_k bends and scales E_k by noise and adds noise where it moves the skin, away from the lids, which
must still close.

Letters: v vertices, p points, k expressions. Rest pose, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from avatarrex.capture.synthetic.mesh import averaging, smoothed
from avatarrex.capture.synthetic.subject import FACE_SOLIDS, Subject
from avatarrex.signals.joints import FINGERS

SEED = 7
"""Of this one person."""
DIFFERENCE = (0.1, 0.3)
"""Least and most of |P_k| / |E_k| over skin, teeth and tongue."""
EYE_RIGID, EYE_FREE = 0.017, 0.034
"""Metres from an eye's centre within which D is a similarity, and beyond which it is free; an eye's radius is 16 mm."""
NOISE_WAVE, NOISE_HEIGHT = 0.06, 0.0012
"""Wavelength and root mean square of D's noise on head and hands, metres."""
EXPRESSION_WAVE = 0.05
_STEP = 1e-4
"""Metres of the central differences of ∂D/∂x."""
PALETTE: dict[str, np.ndarray] = {
    "body": np.diag([0.80, 0.74, 0.70]), "hair": np.diag([0.42, 0.40, 0.42]),
    "shirt": np.array([[0.0, 0.15, 0.85], [0.0, 1.0, 0.0], [0.9, 0.1, 0.0]]),
    "tunic": np.array([[0.2, 0.4, 0.4], [0.6, 0.2, 0.2], [0.3, 0.3, 0.4]]), "trousers": np.diag([0.86, 0.74, 0.52]),
    "left_shoe": np.array([[0.4, 0.3, 0.3], [0.5, 0.3, 0.2], [0.5, 0.2, 0.3]]),
    "left_eye": np.array([[0.0, 0.3, 0.7], [0.5, 0.4, 0.1], [1.1, 0.0, -0.1]]), "upper_teeth": np.diag([0.97, 0.95, 0.88]),
}  # fmt: skip
"""Colours of each solid, linear in those of the default subject: darker skin and hair, brown eyes, other dyes."""
for _first, _others in (("left_shoe", "right_shoe"), ("left_eye", "right_eye"), ("upper_teeth", "lower_teeth")):
    PALETTE[_others] = PALETTE[_first]
Field = Callable[[np.ndarray], np.ndarray]
"""(p, 3) metres to (p, …)."""


@dataclass(frozen=True)
class Bulge:
    """A push (3,) that fades over `radius` (3,) about `centre` (3,) and its mirror image, metres."""

    centre: tuple[float, float, float]
    radius: tuple[float, float, float]
    push: tuple[float, float, float]


FACE = (
    Bulge((0.060, 0.635, 0.055), (0.030, 0.032, 0.050), (0.0060, -0.001, 0)),  # angle of the jaw
    Bulge((0, 0.603, 0.120), (0.026, 0.024, 0.034), (0, -0.0070, 0.0055)),  # chin
    Bulge((0, 0.714, 0.140), (0.013, 0.016, 0.024), (0, 0, 0.0045)),  # bridge of the nose
    Bulge((0, 0.685, 0.158), (0.016, 0.015, 0.026), (0, -0.0045, 0.0050)),  # tip of the nose
    Bulge((0.017, 0.681, 0.140), (0.012, 0.012, 0.020), (0.0035, 0, 0)),  # wings of the nose
    Bulge((0.030, 0.749, 0.125), (0.032, 0.012, 0.028), (0, -0.001, 0.0042)),  # brow ridge
    Bulge((0.058, 0.697, 0.090), (0.024, 0.020, 0.032), (0.0045, 0.001, 0.0040)),  # cheekbone
    Bulge((0.050, 0.660, 0.090), (0.022, 0.018, 0.030), (-0.0030, 0, -0.0030)),  # cheek
    Bulge((0, 0.653, 0.138), (0.034, 0.013, 0.022), (0, -0.0010, 0.0030)),  # lips
    Bulge((0.027, 0.653, 0.122), (0.015, 0.013, 0.022), (0.0035, 0, 0)),  # corners of the mouth
    Bulge((0.090, 0.703, 0.010), (0.022, 0.040, 0.034), (0.0060, 0.003, -0.002)),  # ear
    Bulge((0, 0.795, 0.095), (0.060, 0.038, 0.055), (0, 0.0040, -0.0050)),  # forehead
    Bulge((0, 0.100, 0.120), (0.130, 0.120, 0.090), (0, 0, 0.0140)),  # belly
)
"""How far each goes is drawn between half and the whole."""


def other_person(subject: Subject) -> Subject:
    """The other person in the clothes of `subject`, with the template's expression shapes as they bend with the face."""
    rng = np.random.default_rng([SEED, 0])
    body, rest = subject.model, subject.vertices
    joints = body.joint_template.double().numpy()
    field = _field(joints, body.joint_names, rng)
    moved = rest + field(rest) + _fingers(subject, joints, rng)
    bend = torch.from_numpy(_bend(field, rest).astype(np.float32))
    template = torch.from_numpy((joints + field(joints)).astype(np.float32))
    model = replace(
        body,
        v_template=torch.from_numpy(moved.astype(np.float32)),
        joint_template=template,
        shapedirs=bend @ body.shapedirs,
        expression_dirs=bend @ body.expression_dirs,
        posedirs=None if body.posedirs is None else bend @ body.posedirs,
    )
    person = replace(subject.person, body=replace(subject.person.body, joint_template=template))
    return replace(subject, person=person, model=model, palette=PALETTE)


def own_expressions(subject: Subject) -> Subject:
    """The same subject with expression shapes that differ from its own by `DIFFERENCE`, drawn for each."""
    rng = np.random.default_rng([SEED, 1])
    model, place = subject.model, subject.pattern
    free = _free_of_eyes(place, _eyes(subject.person_joints, model.joint_names))[:, None]
    mean = averaging(subject.faces, len(place))
    skin = np.isin(np.array(subject.names)[subject.solid_of_vertex], ("body", *FACE_SOLIDS))
    directions = model.expression_dirs.double().numpy()
    rows = np.flatnonzero(np.abs(directions).max((1, 2)) > 0)
    other = directions.copy()
    for k in range(directions.shape[2]):
        own = directions[..., k]
        reach = smoothed(mean, np.linalg.norm(own, axis=1), 12)[rows, None]
        gain, turn, push = (_noise(place[rows], rng, EXPRESSION_WAVE, width) for width in (1, 3, 3))
        change = np.zeros_like(own)
        change[rows] = (gain * own[rows] + 0.5 * np.cross(turn, own[rows]) + 0.5 * reach * push) * free[rows]
        wanted = rng.uniform(*DIFFERENCE) * np.linalg.norm(own[skin])
        other[..., k] += change * (wanted / np.linalg.norm(change[skin]))
    return replace(subject, model=replace(model, expression_dirs=torch.from_numpy(other.astype(np.float32))))


def _field(joints: np.ndarray, names: tuple[str, ...], rng: np.random.Generator) -> Field:
    """D, a similarity about each eye."""
    free, eyes = _free_field(rng), _eyes(joints, names)
    scale = rng.uniform(-0.05, 0.05)
    shift = free(eyes)

    def field(points: np.ndarray) -> np.ndarray:
        offset = points[:, None] - eyes
        near = 1 - _smoothstep((np.linalg.norm(offset, axis=2) - EYE_RIGID) / (EYE_FREE - EYE_RIGID))[..., None]
        return np.asarray(free(points) * (1 - near).prod(1) + (near * (shift + scale * offset)).sum(1))

    return field


def _free_field(rng: np.random.Generator) -> Field:
    """D without regard to the eyes."""
    amounts = rng.uniform(0.5, 1.0, len(FACE))
    skull = rng.uniform(-1, 1, 3) * 0.02 + np.array([0.045, -0.02, 0.03])
    waves = np.random.default_rng([SEED, 2])
    noise = _noise_field(waves, NOISE_WAVE, 3)

    def field(points: np.ndarray) -> np.ndarray:
        moved = _build(points)
        about = points - np.array([0, 0.715, 0.03])
        head = np.exp(-((np.linalg.norm(about, axis=1) / 0.17) ** 4))[:, None]
        hand = _smoothstep((np.abs(points[:, :1]) - 0.70) / 0.05)
        moved += head * skull * about + NOISE_HEIGHT * (head + hand) * noise(points)
        for amount, bulge in zip(amounts, FACE):
            for mirror in (1, -1)[: 2 if bulge.centre[0] else 1]:
                flip = np.array([mirror, 1, 1])
                far = (((points - flip * bulge.centre) / bulge.radius) ** 2).sum(1)
                moved += amount * np.exp(-far)[:, None] * (flip * bulge.push)
        return moved

    return field


def _build(points: np.ndarray) -> np.ndarray:
    """(p, 3): legs 2 cm longer (the soles stay), arms 1.5 cm shorter, trunk 4 % wider, palms wider and fingers longer."""
    side, (x, y, z) = np.sign(points[:, 0]), np.abs(points.T) * [[1], [0], [0]] + points.T * [[0], [1], [1]]
    trunk = 0.04 * _smoothstep((y + 0.25) / 0.2) * _smoothstep((0.50 - y) / 0.1) * _smoothstep((0.26 - x) / 0.1)
    hand = _smoothstep((x - 0.70) / 0.06)
    finger = np.maximum(x - 0.79, 0)
    along = trunk * x - 0.015 * _smoothstep((x - 0.22) / 0.45) + 0.10 * finger**2 / (finger + 0.02)
    up = 0.020 * _smoothstep((y + 0.85) / 0.80)
    return np.stack([side * along, up, trunk * z + 0.09 * hand * (z - 0.008)], 1)


def _fingers(subject: Subject, joints: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(v, 3): away from the bones of each finger, by 6 to 16 % of the distance and more at the knuckles."""
    model, rest = subject.model, subject.vertices
    weights = model.weights.double().numpy()
    moved = np.zeros_like(rest)
    for side in ("left", "right"):
        for finger in FINGERS:
            bones = [model.joint_names.index(f"{side}_{finger}{k}") for k in (1, 2, 3)]
            share = weights[:, bones].sum(1)
            own = np.flatnonzero((share > 0) & (subject.solid_of_vertex == 0))
            chain = joints[bones]
            chain = np.concatenate([chain, [2 * chain[2] - chain[1]]])
            away, along = _from_chain(rest[own], chain)
            knots = np.r_[0, np.cumsum(np.linalg.norm(np.diff(chain[:3], axis=0), axis=1))]
            knuckle = np.exp(-(((along[:, None] - knots) / 0.007) ** 2)).sum(1)
            thicker = rng.uniform(0.06, 0.12) + rng.uniform(0.03, 0.05) * knuckle
            moved[own] += (share[own] * thicker)[:, None] * away
    return moved


def _from_chain(points: np.ndarray, chain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (p, 3) from the nearest point of a chain of segments, and the length (p,) along the chain to it."""
    start, bone = chain[:-1], np.diff(chain, axis=0)
    length = np.linalg.norm(bone, axis=1)
    t = np.clip(((points[:, None] - start) * bone).sum(2) / length**2, 0, 1)
    away = points[:, None] - (start + t[..., None] * bone)
    nearest = np.linalg.norm(away, axis=2).argmin(1)
    each = np.arange(len(points))
    return away[each, nearest], (np.r_[0, np.cumsum(length)[:-1]] + t * length)[each, nearest]


def _bend(field: Field, points: np.ndarray) -> np.ndarray:
    """(p, 3, 3): I + ∂D/∂x."""
    steps = _STEP * np.eye(3)
    columns = [(field(points + step) - field(points - step)) / (2 * _STEP) for step in steps]
    return np.eye(3) + np.stack(columns, 2)


def _eyes(joints: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """(2, 3) centres."""
    return joints[[names.index("left_eye"), names.index("right_eye")]]


def _free_of_eyes(points: np.ndarray, eyes: np.ndarray) -> np.ndarray:
    """(p,) 0 on eyes and lids, 1 from `EYE_FREE` on."""
    away = np.linalg.norm(points[:, None] - eyes, axis=2).min(1)
    return _smoothstep((away - EYE_RIGID - 0.003) / (EYE_FREE - EYE_RIGID))


def _noise(points: np.ndarray, rng: np.random.Generator, wave: float, width: int) -> np.ndarray:
    return _noise_field(rng, wave, width)(points)


def _noise_field(rng: np.random.Generator, wave: float, width: int) -> Field:
    """Smooth noise (p, width), root mean square 1: sixteen plane waves of `wave` metres and up to twice that."""
    towards = rng.standard_normal((16, 3))
    towards *= 2 * np.pi / (wave * rng.uniform(1, 2, (16, 1)) * np.linalg.norm(towards, axis=1, keepdims=True))
    phase, height = rng.uniform(0, 2 * np.pi, 16), rng.standard_normal((16, width)) / np.sqrt(8)
    return lambda points: np.sin(points @ towards.T + phase) @ height


def _smoothstep(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))
