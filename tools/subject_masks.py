"""Per-vertex numbers that the subject's texture reads (`avatarrex/capture/synthetic/texture.py`).

Letters: v vertices, f faces, t texture coordinates. T-pose, root frame, metres.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from subject_body import Body, X, Y
from subject_garments import Piece

from avatarrex.capture.synthetic.mesh import vertex_normals
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import DATA
from avatarrex.signals.joints import FINGERS


def masks(body: Body, pieces: list[Piece]) -> dict[str, np.ndarray]:
    """Per-vertex numbers for the texture, body first.

    `lip` and `lid`: metres from the rim of the mouth and of the eyelids, negative inside the cavity. `edge`: metres
    from the nearest cut of a garment. `nail_u`, `nail_v`: coordinates on the nail (unit circle), far away elsewhere.
    `interior`: 1 on cloth, falling to 0 at hems.
    """
    arrays = read_arrays(DATA / "person.npz", ("f", "ft"))
    chart, charts = _charts(arrays["ft"].astype(np.int64))
    faces = arrays["f"].astype(np.int64)
    n = len(body.vertices)
    total = n + sum(len(piece.vertices) for piece in pieces)
    out = {name: np.full(total, 0.03) for name in ("lip", "lid")}
    out.update({name: np.full(total, 9.0) for name in ("nail_u", "nail_v")})
    out.update(edge=np.full(total, 0.2), interior=np.zeros(total))
    on_skin = (faces < n).all(1)
    for c in range(charts):
        own, other = faces[chart == c], faces[(chart != c) & on_skin]
        if own.max() >= n:
            continue
        ids = np.unique(own)
        centre = body.vertices[ids].mean(0)
        if np.ptp(body.vertices[ids], axis=0).max() > 0.12 or centre[Y] <= body.joints["neck"][Y]:
            continue
        distance = cKDTree(_ring_points(own, other, body.vertices)).query(body.vertices)[0]
        distance[np.setdiff1d(ids, other)] *= -1
        rim = out["lip" if abs(centre[X]) < 0.005 else "lid"][:n]
        nearer = np.abs(distance) < np.abs(rim)
        rim[nearer] = np.clip(distance[nearer], -0.03, 0.03)
    _nails(body, out)
    for piece, stop in zip(pieces, n + np.cumsum([len(piece.vertices) for piece in pieces])):
        if piece.covers and piece.cloth:
            start = stop - len(piece.vertices)
            cloth, level = slice(start, start + piece.cloth), -piece.covers(piece.vertices[: piece.cloth])
            out["edge"][start:stop] = 0
            out["edge"][cloth] = np.clip(level, 0, 0.2)
            out["interior"][cloth] = np.clip(level / 0.025, 0, 1)
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
        return set(map(tuple, np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1).tolist()))

    shared = np.array(sorted(edges(own) & edges(other)))
    s = np.linspace(0, 1, 12)[:, None, None]
    return (vertices[shared[:, 0]] * (1 - s) + vertices[shared[:, 1]] * s).reshape(-1, 3)


def _nails(body: Body, out: dict[str, np.ndarray]) -> None:
    """Nail coordinates on the last 16 mm of each finger's back."""
    normal = vertex_normals(body.vertices, body.faces)
    for side in ("left", "right"):
        for finger in FINGERS:
            column = body.model.joint_names.index(f"{side}_{finger}3")
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
