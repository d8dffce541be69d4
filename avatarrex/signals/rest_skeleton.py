"""The default person at rest, as far as retargeting and grounding need it: joints, and which joint each vertex follows.

Read from the packaged arrays in NumPy: templates, which need torch, stand above signals. Letters: v vertices. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import DATA


@dataclass(frozen=True, eq=False)
class RestSkeleton:
    """T-pose, root frame."""

    joints: np.ndarray
    """(55, 3)."""
    parents: tuple[int, ...]
    """The root's is −1."""
    vertices: np.ndarray
    """(v, 3)."""
    owner: np.ndarray
    """(v,) the joint with the largest skinning weight."""


@lru_cache(maxsize=1)
def rest_skeleton() -> RestSkeleton:
    """Read once."""
    arrays = read_arrays(DATA / "person.npz", ("J_template", "kintree_table", "v_template", "weights"))
    joints, vertices = (arrays[name].astype(np.float64) for name in ("J_template", "v_template"))
    parents = (-1, *arrays["kintree_table"][0, 1:].tolist())
    return RestSkeleton(joints, parents, vertices, arrays["weights"].argmax(1))
