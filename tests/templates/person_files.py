"""SMPL-X, MANO and Faceverse files of somebody who can be looked at: the default person, remeshed to the published counts.

The skin is simplified; a hand is a disc beyond the wrist whose rim has 16 edges, as MANO's; triangles are split in the middle until the
counts are 778 and 10 475. What vertices have (weights, directions) is interpolated from the nearest of the default person's.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import fast_simplification
import numpy as np
from official import PARENTS
from official_files import write_chumpy, write_faceverse, write_smplx
from python2_pickles import write_python2
from scipy.spatial import cKDTree

from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import DATA
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.person import load_person

SKIN_FACES, OPEN_FACES = 10_000, 15
"""Triangles of the simplified skin; of each eyeball those left out at its back, by which the file has 20 908."""
LANDMARKS = {27: (0, 0.0, 0.012), 30: (0, -0.045, 0.03), 36: (-0.046, 0, 0), 39: (-0.018, -0.002, 0.006), 42: (0.018, -0.002, 0.006),
             45: (0.046, 0, 0), 48: (-0.026, -0.075, 0.012), 54: (0.026, -0.075, 0.012), 8: (0, -0.12, 0.01), 0: (-0.075, -0.03, -0.06),
             16: (0.075, -0.03, -0.06)}  # fmt: skip
"""Of iBUG's 68, about where they are: metres from between the eyes."""
J0 = np.array([0.003, -0.351, 0.012])
"""Where the file has its pelvis, as SMPL-X's does."""


def open_edges(faces: np.ndarray) -> list[tuple[int, int]]:
    there = set(map(tuple, faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()))
    return [edge for edge in there if edge[::-1] not in there]


def split(points: list[np.ndarray], faces: list[tuple[int, ...]], own: list[int], count: int) -> None:
    """Put `count` vertices into the middles of the triangles `own`, the largest first; three each where one was."""

    a, b, c = np.array(points)[np.array(faces)[own]].swapaxes(0, 1)
    order = np.argsort(-np.linalg.norm(np.cross(b - a, c - a), axis=1), kind="stable")
    for k in (own[row] for row in order[:count]):
        a, b, c = faces[k]
        points.append((points[a] + points[b] + points[c]) / 3)
        middle = len(points) - 1
        faces[k] = (a, b, middle)
        faces += [(b, c, middle), (c, a, middle)]


@cache
def remeshed() -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Vertices, triangles, the hands' vertices by side, and the eyeballs' by name."""
    arrays = read_arrays(DATA / "person.npz")
    rest, faces, group = arrays["v_template"].astype(np.float64), arrays["f"].astype(int), arrays["vertex_group"]
    skin = faces[(group[faces] == 0).all(1)]
    simple, triangles = fast_simplification.simplify(
        rest[group == 0].astype(np.float32), skin.astype(np.int32), target_count=SKIN_FACES
    )
    points, listed = list(simple.astype(np.float64)), [tuple(face) for face in triangles.tolist()]
    hands = {}
    for side in ("left", "right"):
        own = hand_faces(np.array(points), np.array(listed), side, arrays)
        missing = 778 - len(np.unique(np.array(listed)[own]))
        before = len(listed)
        split(points, listed, own, missing)
        hands[side] = np.unique(np.array([listed[k] for k in [*own, *range(before, len(listed))]]))
    eyes = {}
    for name in ("left_eye", "right_eye"):
        rows = np.flatnonzero(group == list(arrays["group_names"]).index(name))
        ball = faces[np.isin(faces, rows).all(1)]
        ball = ball[np.argsort(rest[ball].mean(1)[:, 2])][OPEN_FACES:]
        eyes[name] = np.arange(len(points), len(points) + len(rows))
        listed += [tuple(face) for face in (np.searchsorted(rows, ball) + len(points)).tolist()]
        points += list(rest[rows])
    fixed = np.zeros(len(points), bool)
    fixed[np.concatenate([*hands.values(), *eyes.values()])] = True
    others = np.flatnonzero(~fixed[np.array(listed)].any(1)).tolist()
    split(points, listed, others, 10475 - len(points))
    return np.array(points), np.array(listed), hands, eyes


def hand_faces(points: np.ndarray, faces: np.ndarray, side: str, arrays: dict[str, np.ndarray]) -> list[int]:
    """The triangles beyond the wrist, of a disc with 16 open edges."""
    joint = dict(zip(arrays["joint_names"], arrays["J_template"].astype(np.float64)))
    wrist, elbow = joint[f"{side}_wrist"], joint[f"{side}_elbow"]
    along = (points - wrist) @ ((wrist - elbow) / np.linalg.norm(wrist - elbow))
    for beyond in np.arange(-0.02, 0.02, 0.0005):
        inside = ((along > beyond) & (np.sign(points[:, 0]) == np.sign(wrist[0])) & (np.abs(points[:, 0]) > 0.5))[
            faces
        ].all(1)
        rim, own = open_edges(faces[inside]), np.flatnonzero(inside)
        if len(rim) == 16 and 2 * len(np.unique(faces[own])) - len(own) == 18:
            return own.tolist()
    raise AssertionError(f"no {side} hand with a rim of 16 edges")


def write_person(folder: Path) -> Path:
    """A models folder with all five files."""
    folder.mkdir(parents=True)
    hands = remeshed()[2]
    write_smplx(folder / "SMPLX_NEUTRAL.npz", person_smplx())
    write_chumpy(folder / "MANO_LEFT.pkl", person_mano("left"))
    write_chumpy(folder / "MANO_RIGHT.pkl", person_mano("right"))
    write_python2(folder / "MANO_SMPLX_vertex_ids.pkl", {f"{side}_hand": hands[side] for side in hands})
    write_faceverse(folder / "faceverse_simple_v2.npy", person_faceverse())
    return folder


@cache
def person_smplx() -> dict[str, np.ndarray]:
    """The arrays of an SMPL-X file, version 1.0."""
    arrays = read_arrays(DATA / "person.npz")
    points, faces, _, eyes = remeshed()
    group, names = arrays["vertex_group"], list(arrays["group_names"])
    taken = {}
    source = np.zeros((len(points), 3), int)
    share = np.zeros((len(points), 3))
    balls = np.concatenate(list(eyes.values()))
    for rows, kind in [
        (np.setdiff1d(np.arange(len(points)), balls), "body"),
        *((rows, name) for name, rows in eyes.items()),
    ]:
        theirs = np.flatnonzero(group == names.index(kind))
        away, near = cKDTree(arrays["v_template"][theirs]).query(points[rows], 3)
        weight = 1 / np.maximum(away, 1e-7)
        source[rows], share[rows] = theirs[near], weight / weight.sum(1, keepdims=True)

    def of(values: np.ndarray) -> np.ndarray:
        return np.einsum("vk,vk...->v...", share, values[source].astype(np.float64))

    directions = np.concatenate([arrays["shapedirs"][..., :10], arrays["shapedirs"][..., 10:20]], -1)
    posedirs = np.zeros((len(points), 3, 486), np.float32)
    posedirs[..., arrays["pose_columns"]] = of(arrays["posedirs"])
    parents = np.array(PARENTS, dtype=np.int64)
    parents[0] = 2**32 - 1
    taken = {
        "v_template": points + J0, "f": faces.astype(np.uint32), "shapedirs": of(directions), "posedirs": posedirs,
        "weights": of(arrays["weights"]), "kintree_table": np.stack([parents, np.arange(55)]),
        "J_regressor": nearby(points, arrays["J_template"].astype(np.float64)),
        **{f"hands_components{s}": np.eye(45) for s in "lr"}, **{f"hands_mean{s}": np.zeros(45) for s in "lr"},
    }  # fmt: skip
    faces_of = [points[faces].mean(1), eyes_between(arrays)]
    near = cKDTree(faces_of[0]).query(
        np.array([LANDMARKS.get(k, (0, -0.03, 0.02)) for k in range(17, 68)]) + faces_of[1]
    )[1]
    return {**taken, "lmk_faces_idx": near, "lmk_bary_coords": np.full((51, 3), 1 / 3)}


def eyes_between(arrays: dict[str, np.ndarray]) -> np.ndarray:
    joint = dict(zip(arrays["joint_names"], arrays["J_template"].astype(np.float64)))
    return (joint["left_eye"] + joint["right_eye"]) / 2 + [0, 0, 0.02]


def nearby(points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """A regressor of the 24 nearest vertices, whose rows sum to one and make the joints lie where they should."""
    found = np.zeros((len(joints), len(points)))
    for row, joint in zip(found, joints):
        chosen = cKDTree(points).query(joint, 24)[1]
        row[chosen] = (
            1 / 24
            + np.linalg.lstsq(
                np.vstack([points[chosen].T, np.ones(24)]), [*(joint - points[chosen].mean(0)), 0], rcond=None
            )[0]
        )
    return found


def person_mano(side: str) -> dict[str, np.ndarray]:
    """The arrays of a MANO file: the hand of `person_smplx`, somewhere else."""
    body, (_, faces, hands, _) = person_smplx(), remeshed()
    ids = hands[side]
    first = {"left": 25, "right": 40}[side]
    joints = [{"left": 20, "right": 21}[side], *range(first, first + 15)]
    weights = body["weights"][ids][:, joints]
    weights[:, 0] = np.maximum(1 - weights[:, 1:].sum(1), 0)
    points = body["v_template"][ids] - 0.6 * np.sign(body["v_template"][ids[0], 0]) * np.eye(3)[0]
    own = faces[np.isin(faces, ids).all(1)]
    where = body["J_regressor"] @ body["v_template"]
    placed = where[joints] - 0.6 * np.sign(body["v_template"][ids[0], 0]) * np.eye(3)[0]
    return {
        "v_template": points, "f": np.searchsorted(ids, own).astype(np.uint32), "shapedirs": body["shapedirs"][ids][..., :10],
        "posedirs": np.zeros((778, 3, 135)), "J_regressor": nearby(points, placed), "weights": weights,
        "kintree_table": np.array([[2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14], range(16)]),
        "hands_components": np.eye(45), "hands_mean": np.zeros(45),
    }  # fmt: skip


def person_faceverse() -> dict[str, object]:
    """The dict of a Faceverse file, version 2: the default person's head, in decimetres, y and z the other way."""
    arrays, face = read_arrays(DATA / "person.npz"), load_person().face.model
    rest, factor = face.v_template.double().numpy(), np.array([10.0, -10.0, -10.0])
    between = eyes_between(arrays) - dict(zip(arrays["joint_names"], arrays["J_template"]))["head"]
    listed = cKDTree(rest).query(np.array([LANDMARKS.get(k, (0, -0.03, 0.02)) for k in range(68)]) + between)[1]
    order = [EXPRESSION_NAMES.index(name) for name in sorted(EXPRESSION_NAMES)]
    identity = np.zeros((len(rest), 3, 150))
    identity[..., :10] = face.shapedirs.double().numpy()
    return {
        "meanshape": (rest * factor).reshape(1, -1), "idBase": (identity * factor[:, None]).reshape(-1, 150),
        "exBase": (face.expression_dirs.double().numpy()[..., order] * factor[:, None]).reshape(-1, 52),
        "tri": face.faces.numpy(), "keypoints": listed, "exp_name_list": sorted(EXPRESSION_NAMES),
    }  # fmt: skip
