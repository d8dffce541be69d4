"""Rigid transforms between the world and the template's root frame (float64)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def world_from_root(global_orient: np.ndarray, translation: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    """(4, 4): x_world = R (x − J_0) + J_0 + t. The pelvis sits at J_0 + t, not at t (SMPL-X).

    `global_orient` rotvec (3,) radians, `translation` (3,) and `pelvis` J_0 (3,) metres.
    """
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(np.array(global_orient, dtype=np.float64)).as_matrix()
    transform[:3, 3] = pelvis + np.asarray(translation) - transform[:3, :3] @ pelvis
    return transform
