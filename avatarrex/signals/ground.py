"""Where a motion's floor is: soles and other low points of the default person, posed by the skeleton alone.

Files measure heights from floors of their own. Ours lies under the soles of the T-pose. Letters: t frames, j joints, p points.
Metres.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.rest_skeleton import rest_skeleton

_THICKNESS = {"pelvis": 0.11, "knee": 0.06, "elbow": 0.04, "wrist": 0.03, "head": 0.05}
"""Metres of flesh below a joint that may rest on the floor: sitting, kneeling, crawling."""
_SOLE = 0.012
"""Metres above the lowest vertex: what counts as sole."""


def floor_height() -> float:
    """y of the floor in metres: the lowest vertex of the T-pose."""
    return float(rest_skeleton().vertices[:, 1].min())


def lowest(pose: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(t,) height of the lowest point of (t, 55, 3) rotation vectors and (t, 3) translations above the floor."""
    points, joint, thickness = _low_points()
    rest, parents = rest_skeleton().joints, rest_skeleton().parents
    turned = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix().reshape(len(pose), 55, 3, 3)
    places = np.zeros((len(pose), 55, 3))
    places[:, 0] = rest[0]
    for j in range(1, 55):
        places[:, j] = places[:, parents[j]] + turned[:, parents[j]] @ (rest[j] - rest[parents[j]])
        turned[:, j] = turned[:, parents[j]] @ turned[:, j]
    moved = places[:, joint] + np.einsum("tpab,pb->tpa", turned[:, joint], points - rest[joint])
    return np.asarray((moved[..., 1] - thickness).min(1) + translation[:, 1] - floor_height())


def grounded(pose: np.ndarray, translation: np.ndarray, each: bool = False) -> tuple[np.ndarray, str]:
    """Translations shifted vertically so that the lowest point of all frames, or of `each`, is on the floor; a note."""
    height = lowest(pose, translation)
    moved = translation.copy()
    moved[:, 1] -= height if each else height.min()
    how = "the root never rises or sinks: every frame is put on the floor" if each else "lowest frame put on the floor"
    return moved, how


@lru_cache(maxsize=1)
def _low_points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (p, 3) at rest, the joint (p,) that each moves with, thickness (p,) of the flesh below it."""
    person = rest_skeleton()
    low = person.vertices[:, 1] < floor_height() + _SOLE
    found: list[tuple[np.ndarray, int, float]] = []
    for name in ("left_ankle", "right_ankle", "left_foot", "right_foot"):
        j = JOINT_NAMES.index(name)
        sole = person.vertices[(person.owner == j) & low]
        ends = (end for axis in (0, 2) for end in (sole[:, axis].argmin(), sole[:, axis].argmax()))
        found += [(sole[end], j, 0.0) for end in ends]
    for name, below in _THICKNESS.items():
        joints = [JOINT_NAMES.index(full) for full in (name, f"left_{name}", f"right_{name}") if full in JOINT_NAMES]
        found += [(person.joints[j], j, below) for j in joints]
    points, joint, thickness = map(np.array, zip(*found))
    return points, joint, thickness
