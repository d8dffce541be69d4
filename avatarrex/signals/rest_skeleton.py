"""The default person at rest, as far as retargeting and grounding need it: joints, and which joint each vertex follows.

Read from the packaged arrays in NumPy: templates, which need torch, stand above signals. Letters: t frames, v vertices. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

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

    def posed(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(t, 55, 3, 3) global rotations and (t, 55, 3) places of (t, 55, 3) rotation vectors, without translation."""
        turned = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix().reshape(len(pose), 55, 3, 3)
        places = np.zeros((len(pose), 55, 3))
        places[:, 0] = self.joints[0]
        for j in range(1, 55):
            parent = self.parents[j]
            places[:, j] = places[:, parent] + turned[:, parent] @ (self.joints[j] - self.joints[parent])
            turned[:, j] = turned[:, parent] @ turned[:, j]
        return turned, places


@lru_cache(maxsize=1)
def rest_skeleton() -> RestSkeleton:
    """Read once."""
    arrays = read_arrays(DATA / "person.npz", ("J_template", "kintree_table", "v_template", "weights"))
    joints, vertices = (arrays[name].astype(np.float64) for name in ("J_template", "v_template"))
    parents = (-1, *arrays["kintree_table"][0, 1:].tolist())
    return RestSkeleton(joints, parents, vertices, arrays["weights"].argmax(1))
