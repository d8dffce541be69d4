"""Files in the layouts in which SMPL-X, MANO, FLAME and Faceverse are published: keys, shapes, types and faults; numbers are made up.

Hands and head are discs of as many vertices and triangles as the real ones, and a part of the body's mesh, as they are there.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import scipy.sparse
from official import PARENTS
from python2_pickles import chumpy, selected, write_object_array, write_python2

from avatarrex.signals.joints import EXPRESSION_NAMES

HAND_PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
FLAME_PARENTS = (-1, 0, 1, 1, 1)
LEFT_IDS, RIGHT_IDS, HEAD_IDS = np.arange(100, 878), np.arange(1000, 1778), np.arange(2000, 7023)
JOINTS = {
    0: (0, 0, 0), 12: (0, 0.45, 0), 15: (0, 0.55, 0), 20: (0.7, 0.4, 0), 21: (-0.7, 0.4, 0), 22: (0, 0.55, 0.05),
    23: (0.03, 0.6, 0.08), 24: (-0.03, 0.6, 0.08),
}  # fmt: skip


def disc(ring: int, rings: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices on a dome around +x, 18 cm deep, and the triangles of a disc with `ring` open edges."""
    rng = np.random.default_rng(count)
    angle = np.linspace(0, 2 * np.pi, ring, endpoint=False)
    depth = np.linspace(0, 1, rings + 1)[:-1]
    across = np.sqrt(1 - depth**2)[:, None]
    vertices = [
        np.stack(
            [np.repeat(depth[:, None], ring, 1) * 0.18, 0.05 * across * np.cos(angle), 0.03 * across * np.sin(angle)],
            -1,
        ).reshape(-1, 3)
    ]
    faces = []
    for row in range(rings - 1):
        for k in range(ring):
            a, b = row * ring + k, row * ring + (k + 1) % ring
            faces += [(a, b, b + ring), (a, b + ring, a + ring)]
    middle, last = rings * ring, (rings - 1) * ring
    faces += [(last + k, last + (k + 1) % ring, middle) for k in range(ring)]
    points = [*vertices[0], np.array([0.18, 0, 0])]
    while len(points) < count:
        a, b, c = faces.pop(int(rng.integers(len(faces) - ring)))
        points.append(np.mean([points[a], points[b], points[c]], axis=0))
        faces += [(a, b, len(points) - 1), (b, c, len(points) - 1), (c, a, len(points) - 1)]
    return np.array(points), np.array(faces)


def hand_disc(side: str) -> tuple[np.ndarray, np.ndarray]:
    """778 vertices, 1538 triangles, 16 open edges at the wrist; fingers towards +x on the left."""
    points, faces = disc(16, 48, 778)
    return (points, faces) if side == "left" else (points * [-1, 1, 1], faces[:, ::-1])


def head_disc() -> tuple[np.ndarray, np.ndarray]:
    """5023 vertices, 9976 triangles, 68 open edges at the neck."""
    points, faces = disc(68, 73, 5023)
    return points[:, [1, 0, 2]] * [1, 1, -1], faces


def regressor(rng: np.random.Generator, vertices: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Of sixteen vertices a joint, which it makes lie where `joints` says; rows sum to one."""
    found = np.zeros((len(joints), len(vertices)))
    for row, joint in zip(found, joints):
        chosen = rng.choice(len(vertices), 16, replace=False)
        row[chosen] = np.linalg.lstsq(np.vstack([vertices[chosen].T, np.ones(16)]), [*joint, 1], rcond=None)[0]
    return found


def skin(rng: np.random.Generator, count: int, joints: int) -> np.ndarray:
    weights = rng.random((count, joints)) ** 12
    return weights / weights.sum(1, keepdims=True)


def hand_joints(side: str) -> np.ndarray:
    """(16, 3) about the wrist."""
    x = 1 if side == "left" else -1
    finger = [(x * (0.08 + 0.03 * k), 0.002 * k, 0.03 - 0.015 * f) for f in range(5) for k in range(3)]
    return np.array([(0, 0, 0), *finger])


@cache
def smplx(directions: int = 20) -> dict[str, np.ndarray]:
    """A file's arrays: `directions` 20 (v1.0) or 400 (v1.1)."""
    rng = np.random.default_rng(directions)
    count = 10475
    vertices = rng.normal(size=(count, 3)) * 0.2
    joints = rng.normal(size=(55, 3)) * 0.3
    for joint, place in JOINTS.items():
        joints[joint] = place
    for side, first, wrist in (("left", 25, 20), ("right", 40, 21)):
        joints[first : first + 15] = joints[wrist] + hand_joints(side)[1:]
    faces = []
    for ids, (points, own), origin in (
        (LEFT_IDS, hand_disc("left"), joints[20]), (RIGHT_IDS, hand_disc("right"), joints[21]), (HEAD_IDS, head_disc(), joints[12]),
    ):  # fmt: skip
        vertices[ids] = points + origin
        faces.append(ids[own])
    chin = HEAD_IDS[(np.abs(vertices[HEAD_IDS, 0]) < 0.015) & (vertices[HEAD_IDS, 2] > 0)]
    joined = regressor(rng, vertices, joints)
    others = rng.integers(7100, count, (20908 - sum(map(len, faces)), 3))
    parents = np.array(PARENTS, dtype=np.int64)
    parents[0] = 2**32 - 1
    scale = 0.02 / np.sqrt(directions)
    weights = skin(rng, count, 55)
    weights[chin] = np.eye(55)[22]
    return {
        "v_template": vertices, "f": np.concatenate([*faces, others]).astype(np.uint32),
        "shapedirs": rng.standard_normal((count, 3, directions), np.float32) * np.float32(scale),
        "posedirs": rng.standard_normal((count, 3, 486), np.float32) * np.float32(1e-4),
        "J_regressor": joined, "weights": weights, "kintree_table": np.stack([parents, np.arange(55)]).astype(np.uint32),
        **{f"hands_components{s}": np.linalg.qr(rng.normal(size=(45, 45)))[0] for s in "lr"},
        **{f"hands_mean{s}": rng.normal(size=45) * 0.2 for s in "lr"},
        "lmk_faces_idx": rng.integers(0, 9000, 51), "lmk_bary_coords": rng.dirichlet(np.ones(3), 51),
    }  # fmt: skip


def write_smplx(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """An `.npz` with arrays of objects that nobody needs, or a `.pkl`, by the name."""
    others = {"joint2num": {"Pelvis": 0}, "part2num": {"Pelvis": 0}}
    if path.suffix == ".npz":
        np.savez(path, **arrays, **{key: np.array(value, dtype=object) for key, value in others.items()})
        return path
    return write_python2(path, {**arrays, **others})


@cache
def mano(side: str) -> dict[str, np.ndarray]:
    """A hand's arrays, in axes of its own about a point beside the wrist; both sides' shape directions are the right's."""
    rng = np.random.default_rng(5)
    points, faces = hand_disc(side)
    outwards = np.array([1 if side == "left" else -1, 1, 1])
    points = points + rng.normal(size=points.shape) * 2e-4 * outwards
    wrist = np.array([-0.09, 0.006, 0.006]) * outwards
    points, joints = points + wrist, hand_joints(side) + wrist
    joined = regressor(rng, points, joints)
    return {
        "v_template": points, "f": faces.astype(np.uint32), "shapedirs": rng.normal(size=(778, 3, 10)) * 0.003,
        "posedirs": rng.normal(size=(778, 3, 135)) * 2e-4, "J_regressor": joined, "weights": skin(rng, 778, 16),
        "kintree_table": np.array([[2**32 - 1, *HAND_PARENTS[1:]], range(16)]),
        "hands_components": np.linalg.qr(rng.normal(size=(45, 45)))[0], "hands_mean": rng.normal(size=45) * 0.2,
    }  # fmt: skip


def write_chumpy(path: Path, arrays: dict[str, np.ndarray], protocol: int = 2) -> Path:
    """A pickle of Python 2's with chumpy objects and a sparse regressor, as MANO's and FLAME's files are."""
    fields = {
        **arrays, "J_regressor": scipy.sparse.csc_matrix(arrays["J_regressor"]), "v_template": chumpy(arrays["v_template"]),
        "shapedirs": selected(arrays["shapedirs"]), "posedirs": chumpy(arrays["posedirs"]), "weights": chumpy(arrays["weights"]),
        "bs_style": "lbs", "bs_type": "lrotmin",
    }  # fmt: skip
    return write_python2(path, fields, protocol)


@cache
def flame() -> dict[str, np.ndarray]:
    """A head's arrays."""
    rng = np.random.default_rng(6)
    points, faces = head_disc()
    joints = np.array([(0, -0.1, 0), (0, 0, 0), JOINTS[22], JOINTS[23], JOINTS[24]]) - [
        [0, 0, 0],
        [0, 0, 0],
        *[JOINTS[12]] * 3,
    ]
    joined = regressor(rng, points, joints)
    return {
        "v_template": points, "f": faces.astype(np.uint32), "shapedirs": rng.standard_normal((5023, 3, 400), np.float32) * np.float32(1e-3),
        "posedirs": rng.normal(size=(5023, 3, 36)) * 1e-4, "J_regressor": joined, "weights": skin(rng, 5023, 5),
        "kintree_table": np.array([[2**32 - 1, *FLAME_PARENTS[1:]], range(5)]),
    }  # fmt: skip


FACE_POINTS = {
    "chin": (0, -0.06, 0.09),
    "bridge": (0, 0.05, 0.1),
    "tip": (0, 0.01, 0.13),
    "right": (-0.07, 0, 0),
    "left": (0.07, 0, 0),
}
"""Metres, our axes."""
VERSIONS = {
    1: (600, 150, 74, "keypoints"), 2: (6335, 150, 52, "keypoints"), 3: (15456, 150, 171, "mediapipe_keypoints"),
    4: (700, 156, 177, "keypoints_mediapipe"),
}  # fmt: skip
"""Vertices (made up for 1 and 4), shape and expression directions, list of landmarks."""
PLACES = {"keypoints": (68, (8, 27, 30, 0, 16)), "keypoints_68": (70, (8, 27, 30, 0, 16))}


def faceverse(
    version: int, metres: float, signs: tuple[int, int, int]
) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """A file's dict, in a unit of `metres` and with axes turned; and what it means, in metres and our axes."""
    count, shapes, expressions, key = VERSIONS[version]
    rng = np.random.default_rng(version)
    points, faces = disc(20, (count - 20) // 25, count)
    points = points[:, [1, 2, 0]] * [1.5, 2, 0.6]  # a dome to the front
    total, places = PLACES.get(key, (478, (152, 168, 1, 234, 454)))
    listed = rng.choice(count - 60, total, replace=False)
    points[listed[list(places)]] = list(FACE_POINTS.values())
    if version >= 3:  # eyeballs: the last vertices, the person's left first in version 3 alone
        for rows, x in ((slice(-60, -30), 0.03), (slice(-30, None), -0.03)):
            points[rows] = rng.normal(size=(30, 3)) * 0.006 + [x if version == 3 else -x, 0.03, 0.09]
    mean = {"mean": points, "faces": faces, "shape": rng.normal(size=(count, 3, shapes)) * 1e-3,
            "expression": rng.normal(size=(count, 3, expressions)) * 1e-3}  # fmt: skip
    factor = np.array(signs) / metres
    fields: dict[str, object] = {
        "meanshape": (points * factor).reshape(1, -1) if version < 3 else points * factor,
        "idBase": (mean["shape"] * factor[:, None]).reshape(3 * count, -1).astype(np.float32),
        "exBase": (mean["expression"] * factor[:, None]).reshape(3 * count, -1).astype(np.float32),
        "meantex": np.full((1, 3 * count), 120.0), "tri": faces + (version == 1), key: listed.reshape(-1, 1),
    }  # fmt: skip
    if version >= 3:
        fields |= {"ver_inds": np.array([count - 60, count - 30, count]), "tri": faces[:, [0, 2, 1]]}
    if version == 2:
        fields["exp_name_list"] = sorted(EXPRESSION_NAMES)
    return fields, mean


def write_faceverse(path: Path, fields: dict[str, object]) -> Path:
    """The `.npy`."""
    return write_object_array(path, fields)
