"""Which vertices of SMPL-X are a hand's (MANO) or a head's (FLAME): from the published files, or found on the meshes.

These models share SMPL-X's triangles. So one triangle whose place is sure gives all others of its piece: neighbours lie across the same
edges. The first is taken near its nearest vertices, once the joints lie on one another; what is found is checked triangle by triangle.
Letters: v vertices of the part, f faces. Metres.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_array
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.official.known_models import HAND_FILE, HEAD_FILE
from avatarrex.templates.official.model_file import read_dict

HAND_JOINTS = {"left": [20, *range(25, 40)], "right": [21, *range(40, 55)]}
"""SMPL-X's joints in MANO's order."""
HEAD_JOINTS = {1: 12, 2: 22, 3: 23, 4: 24}
"""SMPL-X's joints by FLAME's: neck, jaw, eyes."""
FARTHEST = 0.03
"""Metres by which a vertex may be off its counterpart once the joints are aligned: mean bodies of two data sets."""
SHARED = 0.99
"""Share of a part's triangles that are SMPL-X's, too; the closed wrist is not counted."""
SEEDS = 40
"""First triangles that are tried for a piece."""


def read_hand_ids(path: str | Path) -> dict[str, np.ndarray]:
    """(778,) vertices of SMPL-X by side. Raises `InputError`."""
    fields = read_dict(path, f"{HAND_FILE}")
    return {side: _checked(fields.get(f"{side}_hand"), path, f"{side}_hand", 778) for side in ("left", "right")}


def read_head_ids(path: str | Path) -> np.ndarray:
    """(5023,) vertices of SMPL-X, one a vertex of FLAME. Raises `InputError`."""
    return _checked(read_array(path), path, "", 5023)


def _checked(value: object, path: str | Path, field: str, count: int) -> np.ndarray:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iu" or value.shape != (count,):
        raise InputError(path, field, f"({count},) integers", getattr(value, "shape", type(value).__name__))
    if value.min() < 0 or value.max() >= 10475 or len(np.unique(value)) != count:
        raise InputError(path, field, "different vertices from 0 to 10474", "others, or one twice")
    return value.astype(np.int64)


def check_ids(ids: np.ndarray, part: TemplateModel, body: TemplateModel, source: str | Path) -> None:
    """Raise `InputError` unless the triangles of `part` among its first `len(ids)` vertices are the body's."""
    own = part.faces.numpy()
    own = ids[own[(own < len(ids)).all(1)]]
    shared = len(_turned(own) & _turned(body.faces.numpy())) / max(len(own), 1)
    if shared < SHARED:
        expected = f"vertices by which {SHARED:.0%} of the triangles are the body's"
        raise InputError(source, "", expected, f"{shared:.1%}")


def hand_ids(hand: TemplateModel, body: TemplateModel, side: str, file: Path | None = None) -> np.ndarray:
    """(778,) of a hand, closed or not: from the published file, checked, or else found.

    Raises `InputError`, which names the file that is needed where the meshes do not tell.
    """
    if file is not None:
        ids = read_hand_ids(file)[side]
        check_ids(ids, hand, body, file)
        return ids
    return _found(hand, body, dict(enumerate(HAND_JOINTS[side])), 778, HAND_FILE)


def head_ids(head: TemplateModel, body: TemplateModel, file: Path | None = None) -> np.ndarray:
    """(5023,) of a FLAME head, as above."""
    if file is not None:
        ids = read_head_ids(file)
        check_ids(ids, head, body, file)
        return ids
    return _found(head, body, HEAD_JOINTS, 5023, HEAD_FILE)


def _found(part: TemplateModel, body: TemplateModel, joints: dict[int, int], count: int, file: str) -> np.ndarray:
    own = part.joint_template[list(joints)].double().numpy()
    theirs = body.joint_template[list(joints.values())].double().numpy()
    turn, _ = Rotation.align_vectors(theirs - theirs.mean(0), own - own.mean(0))
    placed = turn.apply(part.v_template[:count].double().numpy() - own.mean(0)) + theirs.mean(0)
    faces = part.faces.numpy()
    ids = _grown(placed, faces[(faces < count).all(1)], body.v_template.double().numpy(), body.faces.numpy())
    rest = body.v_template.double().numpy()
    away = np.linalg.norm(placed - rest[ids], axis=1)[ids >= 0].max(initial=0)
    if (ids < 0).any() or len(np.unique(ids)) != count or away > FARTHEST:
        found = f"{int((ids < 0).sum())} of {count} vertices without one, the farthest {away * 100:.1f} cm away"
        raise InputError(file, "", "this file, since the meshes do not tell which vertices are the same", found)
    check_ids(ids, part, body, file)
    return ids


def _grown(placed: np.ndarray, faces: np.ndarray, rest: np.ndarray, body_faces: np.ndarray) -> np.ndarray:
    """The body's vertex of each of the part's, −1 where none was found; piece by piece from one triangle."""
    across, theirs = _across(faces), _across(body_faces)
    distance, nearest = cKDTree(rest).query(placed)
    ids = np.full(len(placed), -1)
    order = np.argsort(distance[faces].sum(1))
    tried = 0
    for face in faces[order]:
        a, b, c = (int(vertex) for vertex in face)
        start = {a: int(nearest[a]), b: int(nearest[b]), c: int(nearest[c])}
        if ids[a] >= 0 or theirs.get((start[a], start[b])) != start[c]:
            continue
        piece = _piece(start, (a, b, c), across, theirs)
        tried += 1
        if piece is not None:
            ids[list(piece)], tried = list(piece.values()), 0
        if tried == SEEDS:
            break
    return ids


def _piece(
    ids: dict[int, int],
    first: tuple[int, int, int],
    across: dict[tuple[int, int], int],
    theirs: dict[tuple[int, int], int],
) -> dict[int, int] | None:
    """Counterparts of all vertices of a piece, from its first triangle's; None where the meshes differ."""
    ids = dict(ids)
    a, b, c = first
    edges = deque([(b, a), (c, b), (a, c)])
    done = set()
    while edges:
        edge = edges.popleft()
        if edge in done or edge not in across:
            continue
        done.add(edge)
        apex, other = across[edge], theirs.get((ids[edge[0]], ids[edge[1]]))
        if other is None or ids.setdefault(apex, other) != other:
            return None
        edges += [(apex, edge[1]), (edge[0], apex)]
    return ids


def _across(faces: np.ndarray) -> dict[tuple[int, int], int]:
    """The vertex opposite each directed edge."""
    found: dict[tuple[int, int], int] = {}
    for a, b, c in faces.tolist():
        found[a, b], found[b, c], found[c, a] = c, a, b
    return found


def _turned(faces: np.ndarray) -> set[tuple[int, ...]]:
    """Triangles, the smallest vertex first."""
    first = faces.argmin(1)
    return set(map(tuple, np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, 1).tolist()))
