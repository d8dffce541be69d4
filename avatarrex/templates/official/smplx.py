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

from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.model_arrays import LARGEST_NUMBER, hash_arrays, read_model
from avatarrex.templates.official.model_file import read_model_file

HEAD, EYES = 15, {"left_eye": 23, "right_eye": 24}
LOCKED = 1e-5
"""Metres: what a unit of a shape direction may change about a head that is locked; SMPL-X's own changes centimetres."""


@dataclass(frozen=True, eq=False)
class SmplxFile:
    """What a file holds."""

    model: TemplateModel
    hand_components: bool
    """Whether the file has principal components and mean of both hands' poses."""
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
    hands = all(f"hands_{kind}{side}" in arrays for kind in ("components", "mean") for side in "lr")
    return SmplxFile(model, hands, *_landmarks(arrays, path, len(model.faces)), _locked(model), hash_arrays(arrays))


def _landmarks(
    arrays: dict[str, np.ndarray], path: str | Path, triangles: int
) -> tuple[Int[np.ndarray, " l"], Float[np.ndarray, "l 3"]]:
    """Triangles of the face's landmarks, and barycentric coordinates on them; none where the file has none."""
    if "lmk_faces_idx" not in arrays or "lmk_bary_coords" not in arrays:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    faces, weights = arrays["lmk_faces_idx"], arrays["lmk_bary_coords"].astype(np.float64)
    if faces.size and not 0 <= faces.min() <= faces.max() < triangles:
        raise InputError(
            path, "lmk_faces_idx", f"triangles from 0 to {triangles - 1}", f"{faces.min()} to {faces.max()}"
        )
    if (largest := np.abs(weights).max(initial=0)) > LARGEST_NUMBER:
        raise InputError(path, "lmk_bary_coords", f"numbers up to {LARGEST_NUMBER:g}", f"{largest:.4g}")
    return faces.astype(np.int64), weights


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
