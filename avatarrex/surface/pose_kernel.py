"""How alike two poses are for a group of vertices: what the corrections of a surface depend on.

    k(R, S) = a + exp(−½ d)      a = Σ_j c_j ⟨R_j − I, S_j − I⟩      d = Σ_j c_j ‖R_j − S_j‖²

over the joints near the group, c_j less the farther they are: a linear function of the turns, and a radial one of their
differences. The reference of `corrections` in pose_loops.py.

Letters: m n poses, j joints, q joints of a group.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64, Int
from scipy.spatial.transform import Rotation


def turns(poses: Float[np.ndarray, "n j 3"]) -> Float64[np.ndarray, "n j 9"]:
    """R_j − I of axis–angle vectors, read row by row."""
    rotation = Rotation.from_rotvec(poses.reshape(-1, 3).astype(np.float64)).as_matrix()
    return np.asarray((rotation - np.eye(3)).reshape(*poses.shape[:2], 9))


def pose_kernel(
    some: Float64[np.ndarray, "m j 9"],
    others: Float64[np.ndarray, "n j 9"],
    joints: Int[np.ndarray, " q"],
    closeness: Float32[np.ndarray, " q"],
) -> Float64[np.ndarray, "m n"]:
    """k of each of `some` with each of `others`, both as `turns`; joints of −1 are none."""
    near, share = joints[joints >= 0], np.sqrt(closeness[joints >= 0].astype(np.float64))
    a, b = ((turn[:, near] * share[:, None]).reshape(len(turn), -1) for turn in (some, others))
    alike = a @ b.T
    apart = np.square(a).sum(1)[:, None] + np.square(b).sum(1) - 2 * alike
    return np.asarray(alike + np.exp(-apart / 2))
