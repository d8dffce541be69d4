"""Feet that stand, kept where they stand: a planted sole neither slides nor sinks; the leg follows by its two bones.

A foot is planted while it is low and slow. Its ankle is moved to where the sole lies on the floor and stays over the contact, eased
in and out; thigh and shin turn within their plane to reach it, and the foot keeps its rotation. Letters: t frames. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from avatarrex.signals.direction import TINY, smallest_turn, unit
from avatarrex.signals.ground import heights, low_points
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.rest_skeleton import rest_skeleton

LOW = 0.05
"""Metres over the floor below which a sole may stand."""
SLOW = 0.35
"""Metres a second below which it does; the foot that swings goes at 2 to 4."""
SHORTEST = 0.08
"""Seconds of a contact; a shorter one is noise."""
EASE = 0.06
"""Seconds, the standard deviation of the easing in and out."""
STRETCH = 0.999
"""Share of the leg's length that it reaches: a straight knee has no plane."""


def locked(pose: np.ndarray, translation: np.ndarray, fps: float) -> np.ndarray:
    """(t, 55, 3) rotation vectors with planted feet locked; `translation` (t, 3) stands on the floor already."""
    pose = pose.copy()
    height, joints = heights(pose, translation), low_points().joint
    for side in ("left", "right"):
        hip, knee, ankle, foot = (JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle", "foot"))
        sole = height[:, (joints == ankle) | (joints == foot)].min(1)
        turned, places = rest_skeleton().posed(pose)
        world = places[:, ankle] + translation
        shift = _shift(world, sole, fps)
        if shift.any():
            pose[:, [hip, knee, ankle]] = _reach(turned, places, (hip, knee, ankle), places[:, ankle] + shift)
    return pose


def contacts(ankle: np.ndarray, sole: np.ndarray, fps: float) -> list[slice]:
    """Frames in which a foot stands, from its ankle's places (t, 3) and its sole's heights (t,)."""
    speed = np.linalg.norm(np.gradient(ankle, axis=0), axis=1) * fps if len(ankle) > 1 else np.zeros(1)
    stands = np.concatenate([[False], (sole < LOW) & (speed < SLOW), [False]])
    edges = np.flatnonzero(np.diff(stands.astype(int))).reshape(-1, 2)
    return [slice(int(a), int(b)) for a, b in edges if b - a >= max(SHORTEST * fps, 1)]


@dataclass(frozen=True)
class Contacts:
    """How well one foot stands."""

    spans: int
    """Contacts."""
    slide: float
    """Metres: the farthest of the ankle from the middle of its contact, the mean over contacts."""
    farthest: float
    """The same, the largest."""
    sink: float
    """Metres that the sole is below the floor while it stands, at most."""


def contact_report(pose: np.ndarray, translation: np.ndarray, fps: float) -> dict[str, Contacts]:
    """By side, of (t, 55, 3) rotation vectors and (t, 3) places; a side that never stands is left out."""
    height, joints = heights(pose, translation), low_points().joint
    _, places = rest_skeleton().posed(pose)
    found = {}
    for side in ("left", "right"):
        ankle, foot = (JOINT_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot"))
        sole = height[:, (joints == ankle) | (joints == foot)].min(1)
        world = places[:, ankle] + translation
        spans = contacts(world, sole, fps)
        if spans:
            across = [(world[span] - np.median(world[span], axis=0))[:, [0, 2]] for span in spans]
            away = [float(np.linalg.norm(offset, axis=1).max()) for offset in across]
            sink = max(0.0, -min(float(sole[span].min()) for span in spans))
            found[side] = Contacts(len(spans), float(np.mean(away)), max(away), sink)
    return found


def _shift(ankle: np.ndarray, sole: np.ndarray, fps: float) -> np.ndarray:
    """(t, 3) by how much an ankle has to be moved."""
    shift = np.zeros_like(ankle)
    planted = np.zeros(len(ankle), bool)
    for span in contacts(ankle, sole, fps):
        target = np.median(ankle[span], axis=0)
        shift[span] = target - ankle[span]
        shift[span, 1] = -sole[span]
        planted[span] = True
    weight = gaussian_filter1d(planted.astype(float), EASE * fps, mode="nearest")[:, None]
    eased = gaussian_filter1d(shift, EASE * fps, axis=0, mode="nearest") / np.maximum(weight, TINY)
    moved = np.where(planted[:, None], shift, eased * weight)
    # nothing sinks into the floor
    moved[:, 1] = np.maximum(moved[:, 1], -sole)
    return np.where(np.abs(moved) > 1e-6, moved, 0)


def _reach(turned: np.ndarray, places: np.ndarray, leg: tuple[int, int, int], target: np.ndarray) -> np.ndarray:
    """(t, 3, 3) rotation vectors of hip, knee and ankle with which the ankle is at `target` (t, 3), the foot turned as before."""
    hip, knee, ankle = leg
    upper, lower = places[:, knee] - places[:, hip], places[:, ankle] - places[:, knee]
    a, b = (np.linalg.norm(bone, axis=1) for bone in (upper, lower))
    wanted = target - places[:, hip]
    far = np.minimum(np.linalg.norm(wanted, axis=1), STRETCH * (a + b))
    # the knee stays in the plane of hip, knee and ankle, bent as far as the new distance needs
    normal = np.cross(upper, lower)
    straight = np.linalg.norm(normal, axis=1) < 1e-6
    normal[straight] = turned[straight, hip, :, 0]
    normal = unit(normal)
    inner = np.arccos(np.clip((a**2 + b**2 - far**2) / (2 * a * b), -1, 1))
    bend = Rotation.from_rotvec(normal * (np.pi - inner)[:, None]).as_matrix()
    straight_lower = unit(upper) * b[:, None]
    bent = np.einsum("tab,tb->ta", bend, straight_lower)
    swing = smallest_turn(upper + bent, wanted)
    new_hip = swing @ turned[:, hip]
    new_knee = swing @ smallest_turn(lower, bent) @ turned[:, knee]
    parent = turned[:, rest_skeleton().parents[hip]]
    chain = [parent, new_hip, new_knee, turned[:, ankle]]
    local = [np.swapaxes(before, 1, 2) @ after for before, after in pairwise(chain)]
    return np.stack([Rotation.from_matrix(matrix).as_rotvec() for matrix in local], 1)
