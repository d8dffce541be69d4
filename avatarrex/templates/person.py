"""A person's templates together: body, both hands, face, and the painted weights that compose them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.assets import DATA, read_arrays, require
from avatarrex.errors import InputError
from avatarrex.templates.face import FaceTemplate, cut_face
from avatarrex.templates.hand import HandTemplate, cut_hand
from avatarrex.templates.model import TemplateModel


@dataclass(frozen=True)
class Person:
    """Everything that poses one person."""

    body: TemplateModel
    left_hand: HandTemplate
    right_hand: HandTemplate
    face: FaceTemplate
    blend_weight: Float[Tensor, "v 3"]
    """Painted ω of left hand, right hand and face on the body template."""
    name: str
    hash: str
    """SHA-256 of the template's arrays, first 16 hex digits."""


@lru_cache(maxsize=4)
def load_person(source: str = "default") -> Person:
    """The packaged person ("default") or one from an `.npz` in the same layout. Raises `InputError`."""
    path = DATA / "person.npz" if source == "default" else Path(source)
    arrays = read_arrays(path)
    body = read_model(arrays, path)
    left, right, face = cut_hand(body, "left"), cut_hand(body, "right"), cut_face(body)
    painted = torch.zeros(len(body.v_template), 3)
    for column, hand in enumerate((left, right)):
        painted[hand.body_vertex_ids[:-1], column] = hand.blend_weight[:-1]
    painted[face.body_vertex_ids, 2] = face.blend_weight
    digest = hashlib.sha256()
    for key in ("v_template", "f", "shapedirs", "weights"):
        digest.update(np.ascontiguousarray(arrays[key]).tobytes())
    return Person(body, left, right, face, painted, source, digest.hexdigest()[:16])


def read_model(arrays: dict[str, np.ndarray], source: str | Path) -> TemplateModel:
    """A `TemplateModel` from SMPL-X-layout arrays (`assets_spec/person.json`)."""
    v_template = require(arrays, source, "v_template", (None, 3))
    v = len(v_template)
    shapedirs = require(arrays, source, "shapedirs", (v, 3, None)).astype(np.float32)
    n_shape = int(require(arrays, source, "n_shape", ()))
    weights = require(arrays, source, "weights", (v, None)).astype(np.float32)
    joints = weights.shape[1]
    tree = require(arrays, source, "kintree_table", (2, joints))
    faces = require(arrays, source, "f", (None, 3)).astype(np.int64)
    if faces.max() >= v:
        raise InputError(source, "f", f"vertex indices below {v}", int(faces.max()))
    parents = tuple(-1 if parent > joints else int(parent) for parent in tree[0])
    names = tuple(str(name) for name in require(arrays, source, "joint_names", (joints,)))
    group = require(arrays, source, "vertex_group", (v,))
    group_names = require(arrays, source, "group_names", (None,))
    posed = "posedirs" in arrays
    return TemplateModel(
        v_template=torch.from_numpy(v_template.astype(np.float32)),
        faces=torch.from_numpy(faces),
        shapedirs=torch.from_numpy(shapedirs[..., :n_shape].copy()),
        expression_dirs=torch.from_numpy(shapedirs[..., n_shape:].copy()),
        weights=torch.from_numpy(weights / weights.sum(1, keepdims=True)),
        joint_template=torch.from_numpy(require(arrays, source, "J_template", (joints, 3)).astype(np.float32)),
        joint_shapedirs=torch.from_numpy(require(arrays, source, "J_shapedirs", (joints, 3, n_shape)).astype(np.float32)),
        parents=parents,
        joint_names=names,
        expression_names=tuple(str(name) for name in require(arrays, source, "expression_names", (None,))),
        posedirs=torch.from_numpy(require(arrays, source, "posedirs", (v, 3, None)).astype(np.float32)) if posed else None,
        pose_columns=torch.from_numpy(require(arrays, source, "pose_columns", (None,)).astype(np.int64)) if posed else None,
        groups={str(name): torch.from_numpy(np.flatnonzero(group == k)) for k, name in enumerate(group_names)},
    )
