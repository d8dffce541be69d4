"""Poses of a person from points in space alone, all frames together: the beginning that `capture refine` goes on from.

    argmin  Σ ρ (X_l − x_l)ᵀ Λ_l (X_l − x_l)  +  |θ − θ_0|²/σ_j²  +  |θ beyond its limits|²/σ_b²  +  |θ_t − (θ_{t−1} + θ_{t+1})/2|²/σ_s²

X_l with information Λ_l are triangulated landmarks, θ_0 the rest pose with relaxed fingers. Each limb first points where its landmarks
say (no search can then end in a fold), then Gauss–Newton. Unseen joints follow priors and neighbouring frames. Letters: t frames, j
joints, l landmarks, q joints that are sought, m unknowns of a frame. World metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from avatarrex.capture.fit.landmarks import Landmarks
from avatarrex.capture.fit.pose_change import TURNED, UNKNOWNS
from avatarrex.capture.fit.triangulation import Points
from avatarrex.signals.joints import FINGERS, JOINT_NAMES, JOINT_ROWS
from avatarrex.signals.library import named_hand
from avatarrex.signals.limits import LIMITS

STEPS, FREE_STEPS = 14, 4
"""Of Gauss–Newton, and those at first without smoothness, which is measured against the neighbours of the step before."""
OUTLIER = 0.05
"""Metres at which a landmark's weight has fallen to ¼ (Geman–McClure)."""
LANDMARK_SIGMA = 0.01
"""Metres that a landmark is off beside its noise: detectors do not mark the joints' centres."""
LIMIT_SIGMA, SMOOTH_SIGMA, SMOOTH_PLACE = 0.05, 0.12, 0.03
"""σ_b and σ_s, radians; metres that the root is off its neighbours' middle. Larger where the free steps end farther from it."""
APART, APART_PLACE = 0.3, 0.1
"""Radians and metres from its neighbours' middle at which a frame's tie to them has fallen to ¼: frames may be far apart in time."""
LEAST_RANGE = 0.08
"""σ_j, radians, of an axis that a joint does not turn about; of others it is half of what the joint's limits leave."""
LONGEST_STEP = 0.6
"""Radians a joint turns in one step."""
CHUNK = 64
"""Frames whose equations are in memory at a time."""
LIMBS = (
    ("hip", "knee"), ("knee", "ankle"), ("ankle", "big_toe"), ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "middle1"),
    *((f"{finger}{k}", f"{finger}{k + 1}") for finger in FINGERS for k in (1, 2)),
    *((f"{finger}3", f"{finger}_tip") for finger in FINGERS),
)  # fmt: skip
"""Joints that point at the next landmark of a limb, from the trunk outwards."""
TRUNK = ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
"""What the root's first pose is told by."""


@dataclass(frozen=True, eq=False)
class Bones:
    """A person's joints at rest with what hangs on them."""

    joints: np.ndarray
    """(55, 3), the pelvis at the origin."""
    parents: tuple[int, ...]
    marks: Landmarks

    @property
    def rest(self) -> np.ndarray:
        """(l, 3) landmarks at rest."""
        return np.asarray(self.joints[self.marks.joints] + self.marks.offsets)


@dataclass(eq=False)
class Poses:
    """Rotations (t, 55, 3, 3) of joints relative to their parents, and the pelvis' place (t, 3)."""

    turns: np.ndarray
    place: np.ndarray

    def rotvecs(self) -> np.ndarray:
        """(t, 55, 3)."""
        return np.asarray(Rotation.from_matrix(self.turns.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 55, 3))

    def posed(self, bones: Bones) -> tuple[np.ndarray, np.ndarray]:
        """Rotations to the world (t, 55, 3, 3) and places (t, 55, 3) of the joints."""
        turned, places = self.turns.copy(), np.zeros((len(self.turns), 55, 3))
        places[:, 0] = self.place + bones.joints[0]
        for joint in range(1, 55):
            parent = bones.parents[joint]
            places[:, joint] = places[:, parent] + turned[:, parent] @ (bones.joints[joint] - bones.joints[parent])
            turned[:, joint] = turned[:, parent] @ turned[:, joint]
        return turned, places


@dataclass(frozen=True, eq=False)
class Ties:
    """How tightly frames are tied to their neighbours: a motion of few frames a second turns far between two of them."""

    turn: np.ndarray
    """(q, 1) σ_s, radians."""
    place: float
    """The root's, metres."""

    @classmethod
    def of(cls, poses: Poses) -> Ties:
        """As free poses lie apart, by axis; noise tells two frames apart, too, so that none is tied too tightly."""
        turns, way = _off_middles(poses, np.arange(len(poses.place)))
        apart = np.sqrt(np.square(turns).mean((0, 2)))[:, None]
        return cls(np.maximum(apart, SMOOTH_SIGMA), max(float(np.sqrt(np.square(way).mean())), SMOOTH_PLACE))

    def add(self, poses: Poses, part: slice, diagonal: np.ndarray, pull: np.ndarray) -> None:
        """What neighbouring frames say, to equations (t, m) of some frames."""
        turns, way = _off_middles(poses, np.arange(len(poses.place))[part])
        joined = (1 + (turns**2).sum(2, keepdims=True) / APART**2) ** -2 / self.turn**2
        together = (1 + (way**2).sum(1, keepdims=True) / APART_PLACE**2) ** -2 / self.place**2
        diagonal[:, 3:] += np.broadcast_to(joined, turns.shape).reshape(len(turns), -1)
        pull[:, 3:] += (joined * turns).reshape(len(turns), -1)
        diagonal[:, :3] += together
        pull[:, :3] += together * way


def fit_poses(bones: Bones, points: Points) -> Poses:
    """Of all frames, whose landmarks are `points`."""
    prior = rest_pose()
    poses, ties = first_poses(bones, points), None
    for step in tqdm(range(STEPS), desc="poses", unit="step", leave=False):
        if step == FREE_STEPS and len(poses.place) > 1:
            ties = Ties.of(poses)
        change = np.concatenate(
            [
                _steps(bones, points, poses, slice(start, start + CHUNK), prior, ties)
                for start in range(0, len(poses.place), CHUNK)
            ]
        )
        poses = _stepped(poses, change)
    return poses


def rest_pose() -> np.ndarray:
    """θ_0 (55, 3): the T-pose with relaxed fingers."""
    pose = np.zeros((55, 3))
    for side in ("left", "right"):
        pose[JOINT_ROWS[f"{side}_hand_pose"]] = named_hand("relaxed", side)
    return pose


def first_poses(bones: Bones, points: Points) -> Poses:
    """The root by the trunk's landmarks, limbs as they point; frames without a trunk as the nearest that has one."""
    count = len(points.position)
    turns = np.tile(Rotation.from_rotvec(rest_pose()).as_matrix(), (count, 1, 1, 1))
    place, rows = np.zeros((count, 3)), bones.marks.rows(TRUNK)
    known = np.flatnonzero(points.found[:, rows].sum(1) >= 3)
    for frame in known.tolist():
        seen = rows[points.found[frame, rows]]
        rest, there = bones.rest[seen], points.position[frame, seen]
        turn = Rotation.align_vectors(there - there.mean(0), rest - rest.mean(0))[0]
        turns[frame, 0], place[frame] = turn.as_matrix(), there.mean(0) - turn.apply(rest.mean(0))
    for frame in set(range(count)) - set(known.tolist()) if len(known) else ():
        nearest = known[np.abs(known - frame).argmin()]
        turns[frame, 0], place[frame] = turns[nearest, 0], place[nearest]
    poses = Poses(turns, place)
    for joint, end in LIMBS:
        for side in ("left", "right"):
            _point(bones, points, poses, f"{side}_{joint}", f"{side}_{end}")
    return poses


def _point(bones: Bones, points: Points, poses: Poses, joint: str, end: str) -> None:
    """Turn a joint so that its bone points from its own landmark to `end`, where both were found."""
    start, stop = bones.marks.rows((joint, end))
    number = JOINT_NAMES.index(joint)
    parent = poses.posed(bones)[0][:, bones.parents[number]]
    bone = bones.rest[stop] - bones.rest[start]
    for frame in np.flatnonzero(points.found[:, start] & points.found[:, stop]):
        way = parent[frame].T @ (points.position[frame, stop] - points.position[frame, start])
        if np.linalg.norm(way) > 1e-6:
            poses.turns[frame, number] = _swing(bone, way)


def _swing(bone: np.ndarray, way: np.ndarray) -> np.ndarray:
    """(3, 3) the shortest turn from one direction to another."""
    bone, way = bone / np.linalg.norm(bone), way / np.linalg.norm(way)
    axis, cosine = np.cross(bone, way), float(np.clip(bone @ way, -1, 1))
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        axis, length = np.cross(bone, [1.0, 0.0, 0.0] if abs(bone[0]) < 0.9 else [0.0, 1.0, 0.0]), 1.0
        axis = axis / np.linalg.norm(axis)
    return np.asarray(Rotation.from_rotvec(axis / length * np.arccos(cosine)).as_matrix())


def _sigmas() -> np.ndarray:
    """(q, 3) σ_j of the joints that are sought, by axis: a knee bends and hardly twists; the root's are infinite."""
    sigma = np.maximum((LIMITS[..., 1] - LIMITS[..., 0])[list(TURNED)] / 2, LEAST_RANGE)
    sigma[0] = np.inf
    return np.asarray(sigma)


def _steps(bones: Bones, points: Points, poses: Poses, part: slice, prior: np.ndarray, ties: Ties | None) -> np.ndarray:
    """(t, m) steps of some frames."""
    some = Poses(poses.turns[part], poses.place[part])
    rows, away, weight = _landmark_rows(bones, points, some, part)
    weighted = (weight @ rows).reshape(len(rows), -1, UNKNOWNS).swapaxes(1, 2)
    matrix = weighted @ rows.reshape(len(rows), -1, UNKNOWNS)
    right = (weighted @ away.reshape(len(rows), -1, 1))[..., 0]
    angle = some.rotvecs()[:, list(TURNED)]
    beyond = angle - np.clip(angle, LIMITS[list(TURNED), :, 0], LIMITS[list(TURNED), :, 1])
    beyond[:, 0] = 0
    diagonal, pull = np.zeros((len(angle), UNKNOWNS)), np.zeros((len(angle), UNKNOWNS))
    sigma = _sigmas().ravel() ** -2.0
    bound = (beyond != 0).reshape(len(angle), -1) / LIMIT_SIGMA**2
    diagonal[:, 3:] = sigma + bound + 1e-3
    pull[:, 3:] = sigma * (prior[list(TURNED)] - angle).reshape(len(angle), -1) - bound * beyond.reshape(len(angle), -1)
    diagonal[:, :3] = 1e-3
    if ties is not None:
        ties.add(poses, part, diagonal, pull)
    matrix[:, np.arange(UNKNOWNS), np.arange(UNKNOWNS)] += diagonal
    solved = np.linalg.solve(matrix, (right + pull)[..., None])[..., 0]
    solved[:, 3:] = np.clip(solved[:, 3:], -LONGEST_STEP, LONGEST_STEP)
    return np.asarray(solved)


def _landmark_rows(bones: Bones, points: Points, some: Poses, part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (t, l, 3, m), what is missing (t, l, 3), and weights (t, l, 3, 3) of the landmarks."""
    turned, places = some.posed(bones)
    carriers = bones.marks.joints
    position = places[:, carriers] + np.einsum("tlij,lj->tli", turned[:, carriers], bones.marks.offsets)
    axes = np.stack(
        [turned[:, bones.parents[joint]] if joint else np.tile(np.eye(3), (len(places), 1, 1)) for joint in TURNED], 1
    )
    below = _below(bones.parents)[list(TURNED)][:, carriers]
    arm = (position[:, :, None] - places[:, None, list(TURNED)]) * below.T[None, :, :, None]
    turns = np.cross(axes.swapaxes(2, 3)[:, None], arm[:, :, :, None])  # (t, l, q, axis, xyz)
    rows = np.concatenate(
        [np.tile(np.eye(3), (*position.shape[:2], 1, 1)), np.moveaxis(turns, 4, 2).reshape(*position.shape, -1)], 3
    )
    away = points.position[part] - position
    robust = (1 + ((away**2).sum(2) / OUTLIER**2)) ** -2 * points.found[part]
    return rows, away, softened(points.information[part]) * robust[..., None, None]


def softened(information: np.ndarray) -> np.ndarray:
    """(…, 3, 3) information of points that are off by `LANDMARK_SIGMA`, too; zero stays zero."""
    return np.asarray(np.linalg.solve(np.eye(3) + LANDMARK_SIGMA**2 * information, information))


def _below(parents: tuple[int, ...]) -> np.ndarray:
    """(55, 55) whether the second hangs on the first, or is it."""
    below = np.eye(55, dtype=bool)
    for joint in range(54, 0, -1):
        below[parents[joint]] |= below[joint]
    return below


def _off_middles(poses: Poses, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From each frame to the middle of its neighbours, frames at the ends have one: turns (t, q, 3) and way (t, 3)."""
    count = len(poses.place)
    before, after = np.maximum(frames - 1, 0), np.minimum(frames + 1, count - 1)
    before, after = np.where(frames == 0, after, before), np.where(frames == count - 1, before, after)
    here = poses.turns[frames][:, list(TURNED)].reshape(-1, 3, 3)
    ways = [
        (
            Rotation.from_matrix(poses.turns[other][:, list(TURNED)].reshape(-1, 3, 3))
            * Rotation.from_matrix(here).inv()
        ).as_rotvec()
        for other in (before, after)
    ]
    turns = (ways[0] + ways[1]).reshape(len(frames), -1, 3) / 2
    return turns, (poses.place[before] + poses.place[after]) / 2 - poses.place[frames]


def _stepped(poses: Poses, change: np.ndarray) -> Poses:
    """The poses after a step (t, m)."""
    turns = poses.turns.copy()
    step = Rotation.from_rotvec(change[:, 3:].reshape(-1, 3)).as_matrix().reshape(len(change), -1, 3, 3)
    turns[:, list(TURNED)] = step @ turns[:, list(TURNED)]
    return Poses(turns, poses.place + change[:, :3])
