"""A FLAME file of somebody who can be looked at: the default person's head, remeshed to the published counts, in another size and place."""

from __future__ import annotations

import numpy as np
from official_files import FLAME_PARENTS
from person_files import nearby, split
from scipy.spatial.transform import Rotation

from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.person import load_person

SIZE, TURN, SHIFT = 1.08, Rotation.from_rotvec([0.06, 0, 0]).as_matrix(), np.array([0.004, -0.03, 0.012])
"""Of the file's head against the default person's."""
JAWS = [k for k, name in enumerate(EXPRESSION_NAMES) if name.startswith("jaw")]
OTHERS = [k for k in range(52) if k not in JAWS]


def mixed() -> np.ndarray:
    """(52, 100): how much of each name a coefficient of the file is; none of the jaw's, which turns."""
    mix = np.random.default_rng(2).normal(size=(52, 100)) / 5
    mix[JAWS] = 0
    return mix


def person_flame(mix: np.ndarray) -> dict[str, np.ndarray]:
    """The file's arrays; without tongue and teeth, as FLAME is."""
    face = load_person().face.model
    inner = np.zeros(len(face.v_template), bool)
    for name in ("tongue", "upper_teeth", "lower_teeth"):
        inner[face.groups[name]] = True
    rows = np.flatnonzero(~inner)
    rest = face.v_template.double().numpy()[rows]
    faces = face.faces.numpy()
    faces = np.searchsorted(rows, faces[~inner[faces].any(1)])
    points, listed, shares = _published(rest, faces)

    def of(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("vr,r...->v...", shares, values[rows].astype(np.float64)))

    moved = np.einsum("cd,vde->vce", SIZE * TURN, of(face.expression_dirs.numpy()) @ mix)
    weights = np.column_stack([np.zeros(5023), of(face.weights.numpy())])
    joints = face.joint_template.double().numpy()
    joints = np.concatenate([joints[:1] - [0, 0.05, 0], joints])
    placed = SIZE * points @ TURN.T + SHIFT
    return {
        "v_template": placed, "f": listed.astype(np.uint32),
        "shapedirs": np.concatenate([np.zeros((5023, 3, 300)), moved], -1).astype(np.float32),
        "J_regressor": nearby(placed, SIZE * joints @ TURN.T + SHIFT), "weights": weights,
        "kintree_table": np.array([[2**32 - 1, *FLAME_PARENTS[1:]], range(5)]),
    }  # fmt: skip


def _published(rest: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """5023 points, 9976 triangles (the lowest of the neck left out), and each point's shares (5023, v) of the vertices."""
    points, listed = list(rest), [tuple(face) for face in faces.tolist()]
    split(points, listed, list(range(len(listed))), 5023 - len(rest))
    placed, triangles = np.array(points), np.array(listed)
    shares = np.eye(5023, len(rest))
    for middle in range(len(rest), 5023):
        corners = np.unique(triangles[(triangles == middle).any(1)])
        shares[middle, corners[corners != middle]] = 1 / 3
    kept = np.sort(np.argsort(-placed[triangles].mean(1)[:, 1])[:9976])
    return placed, triangles[kept], shares
