"""Where a motion's floor is: soles and other low points of the default person, posed by the skeleton alone.

Files measure heights from floors of their own. Ours lies under the soles of the T-pose. Letters: t frames, j joints, p points.
Metres.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.signals.joints import JOINT_NAMES

_THICKNESS = {"pelvis": 0.11, "knee": 0.06, "elbow": 0.04, "wrist": 0.03, "head": 0.05}
"""Metres of flesh below a joint that may rest on the floor: sitting, kneeling, crawling."""
_SOLE = 0.012
"""Metres above the lowest vertex: what counts as sole."""


def floor_height() -> float:
    """y of the floor in metres: the lowest vertex of the T-pose."""
    from avatarrex.templates.person import load_person  # needs torch: a wrong file is refused without it

    return float(load_person().body.v_template[:, 1].min())


def lowest(pose: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(t,) height of the lowest point of (t, 55, 3) rotation vectors and (t, 3) translations above the floor."""
    points, joint, thickness, parents, rest = _skeleton()
    turned = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix().reshape(len(pose), 55, 3, 3)
    places = np.zeros((len(pose), 55, 3))
    places[:, 0] = rest[0]
    for j in range(1, 55):
        places[:, j] = places[:, parents[j]] + turned[:, parents[j]] @ (rest[j] - rest[parents[j]])
        turned[:, j] = turned[:, parents[j]] @ turned[:, j]
    moved = places[:, joint] + np.einsum("tpab,pb->tpa", turned[:, joint], points - rest[joint])
    return (moved[..., 1] - thickness).min(1) + translation[:, 1] - floor_height()


def grounded(pose: np.ndarray, translation: np.ndarray, each: bool = False) -> tuple[np.ndarray, str]:
    """Translations shifted vertically so that the lowest point of all frames, or of `each`, is on the floor; a note."""
    height = lowest(pose, translation)
    moved = translation.copy()
    moved[:, 1] -= height if each else height.min()
    how = "the root never rises or sinks: every frame is put on the floor" if each else "lowest frame put on the floor"
    return moved, how


@lru_cache(maxsize=1)
def _skeleton() -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int], np.ndarray]:
    """Points (p, 3) at rest, the joint each moves with, thickness below it; parents and joints of the person."""
    from avatarrex.templates.person import load_person

    body = load_person().body
    vertices, rest = body.v_template.double().numpy(), body.joint_template.double().numpy()
    owner = body.weights.argmax(1).numpy()
    points, joint, thickness = [], [], []
    for name in ("left_ankle", "right_ankle", "left_foot", "right_foot"):
        j = JOINT_NAMES.index(name)
        sole = vertices[(owner == j) & (vertices[:, 1] < floor_height() + _SOLE)]
        for axis in (0, 2):
            for end in (sole[:, axis].argmin(), sole[:, axis].argmax()):
                points.append(sole[end])
                joint.append(j)
                thickness.append(0.0)
    for name, below in _THICKNESS.items():
        for full in [name] if name in JOINT_NAMES else [f"left_{name}", f"right_{name}"]:
            points.append(rest[JOINT_NAMES.index(full)])
            joint.append(JOINT_NAMES.index(full))
            thickness.append(below)
    return np.array(points), np.array(joint), np.array(thickness), [int(p) for p in body.parents], rest
