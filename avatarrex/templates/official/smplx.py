"""SMPL-X as it is published: 10 475 vertices, 55 joints, 10 + 10 (v1.0) or 300 + 100 (v1.1) directions (docs/formats.md).

With a locked head the file has the same arrays, and shape directions that move the head as a whole: `locked_head` says so.
Letters: v vertices, l landmarks. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.model_arrays import hash_arrays, read_model
from avatarrex.templates.official.hand_space import HandSpace
from avatarrex.templates.official.model_file import read_model_file

HEAD, EYES = 15, {"left_eye": 23, "right_eye": 24}
LOCKED = 1e-5
"""Metres: what a unit of a shape direction may change about a head that is locked; SMPL-X's own changes centimetres."""


@dataclass(frozen=True, eq=False)
class SmplxFile:
    """What a file holds."""

    model: TemplateModel
    hands: dict[str, HandSpace]
    """By side ("left", "right"), where the file has them."""
    landmark_faces: Int[np.ndarray, " l"]
    """The triangle of each landmark of the face (51 of iBUG's 68, without the outline); none where the file has none."""
    landmark_weights: Float[np.ndarray, "l 3"]
    """Barycentric coordinates on it."""
    locked_head: bool
    hash: str

    @property
    def version(self) -> str:
        """`300 + 100` directions or `10 + 10`."""
        return f"{self.model.shapedirs.shape[2]} + {self.model.expression_dirs.shape[2]}"


def read_smplx(path: str | Path) -> SmplxFile:
    """Read a model, `.npz` or `.pkl`. Raises `InputError` naming file and key."""
    arrays = read_model_file(path, "smplx", "an SMPL-X")
    model = replace(read_model(arrays, path), joint_names=JOINT_NAMES)
    model = replace(model, groups=_groups(model))
    hands = {
        side: HandSpace(arrays[f"hands_components{side[0]}"].astype(np.float64), arrays[f"hands_mean{side[0]}"].astype(np.float64))
        for side in ("left", "right")
        if f"hands_components{side[0]}" in arrays and f"hands_mean{side[0]}" in arrays
    }  # fmt: skip
    faces, weights = arrays.get("lmk_faces_idx"), arrays.get("lmk_bary_coords")
    if faces is None or weights is None or len(faces) != len(weights):
        faces, weights = np.zeros(0, int), np.zeros((0, 3))
    return SmplxFile(
        model, hands, faces.astype(np.int64), weights.astype(np.float64), _locked(model), hash_arrays(arrays)
    )


def _groups(model: TemplateModel) -> dict[str, torch.Tensor]:
    """The eyeballs, which are pieces of their own that an eye's joint moves, and the body."""
    edges = model.faces[:, [0, 1, 1, 2]].reshape(-1, 2).numpy()
    count = len(model.v_template)
    _, piece = connected_components(coo_array((np.ones(len(edges)), edges.T), (count, count)), directed=False)
    group = np.full(count, "body", dtype="U16")
    for name, joint in EYES.items():
        moved = np.bincount(piece, model.weights[:, joint].numpy()) / np.bincount(piece)
        group[moved[piece] > 0.5] = name
    return {name: torch.from_numpy(np.flatnonzero(group == name)) for name in ("body", *EYES) if (group == name).any()}


def _locked(model: TemplateModel) -> bool:
    """Whether no shape direction changes the head but moves it as a whole."""
    head = model.weights[:, HEAD] > 0.99
    if not head.any():
        return False
    return bool((model.shapedirs[head] - model.shapedirs[head].mean(0)).abs().max() < LOCKED)
