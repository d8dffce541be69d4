"""Where a motion's floor is: soles and other low points of the default person, posed by the skeleton alone.

Files measure heights from floors of their own. Ours lies under the soles of the T-pose. Letters: t frames, p points. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.rest_skeleton import rest_skeleton

_THICKNESS = {"pelvis": 0.11, "knee": 0.06, "elbow": 0.04, "wrist": 0.03, "head": 0.05}
"""Metres of flesh below a joint that may rest on the floor: sitting, kneeling, crawling."""
_SOLE = 0.012
"""Metres above the lowest vertex: what counts as sole."""
STANDS = 0.25
"""Metres a second, upwards or down, below which the lowest point of a body stands: a jump passes it in 25 ms."""
WORDS = {
    "contacts": "what stands is put on the floor, in the median",
    "each": "every frame is put on the floor",
    "lowest": "lowest frame put on the floor",
    "file": "heights as in the file",
}
"""What each of `import_options.FLOORS` does."""


@dataclass(frozen=True, eq=False)
class LowPoints:
    """Points of the body that may touch the floor."""

    points: np.ndarray
    """(p, 3) at rest."""
    joint: np.ndarray
    """(p,) the joint that each moves with."""
    thickness: np.ndarray
    """(p,) metres of flesh below it."""


@cache
def floor_height() -> float:
    """y of the floor in metres: the lowest vertex of the T-pose."""
    return float(rest_skeleton().vertices[:, 1].min())


def heights(pose: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(t, p) heights of `low_points` over the floor, of (t, 55, 3) rotation vectors and (t, 3) translations."""
    low, rest = low_points(), rest_skeleton()
    turned, places = rest.posed(pose)
    moved = places[:, low.joint] + np.einsum("tpab,pb->tpa", turned[:, low.joint], low.points - rest.joints[low.joint])
    return np.asarray(moved[..., 1] - low.thickness + translation[:, 1:2] - floor_height())


def lowest(pose: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(t,) height of the lowest point of (t, 55, 3) rotation vectors and (t, 3) translations above the floor."""
    return np.asarray(heights(pose, translation).min(1))


def grounded(pose: np.ndarray, translation: np.ndarray, how: str, fps: float = 30.0) -> np.ndarray:
    """Translations shifted vertically, `how` as one of `import_options.FLOORS` says."""
    moved = translation.copy()
    if how != "file":
        height = lowest(pose, translation)
        shift = standing(height, fps) if how == "contacts" else height.min()
        moved[:, 1] -= height if how == "each" else shift
    return moved


def on_floor(signals: Signals) -> Signals:
    """`signals` moved up or down until the lowest point is on the floor."""
    height = lowest(signals.full_pose()[None], signals.translation[None])[0]
    return signals.replace(translation=signals.translation - [0.0, height, 0.0])


def standing(height: np.ndarray, fps: float) -> float:
    """The median height (t,) of a body's lowest point over the frames in which it neither rises nor falls, near the lowest.

    Those are frames within a hand's breadth of the lowest tenth: a motion may end on a chair.
    """
    still = np.abs(np.gradient(height)) * fps < STANDS if len(height) > 1 else np.ones(1, bool)
    near = height <= np.quantile(height, 0.1) + 0.1
    chosen = still & near if (still & near).any() else near
    return float(np.median(height[chosen]))


@lru_cache(maxsize=1)
def low_points() -> LowPoints:
    """Ends of the soles, and joints with flesh below them."""
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
    return LowPoints(points, joint, thickness)
