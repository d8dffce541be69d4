"""Inverse kinematics: joint rotations for which limbs are where they are wanted, within the joints' limits.

    min_r  Σ_g w_g² |e_g(r)|² + Σ_j s_j² |r_j − r⁰_j|²      low ≤ r ≤ high

e_g are the goals: a point of a joint at a place (`Place`), a joint turned as in the world (`Orient`), an axis of a joint towards
a place (`Aim`). The second sum is the rest prior: of all poses that reach the goals the one nearest to r⁰ is taken, so that
what is not determined (the swivel of an elbow) neither drifts nor flips. Damped Gauss–Newton on the rotation vectors with an
active set for the limits; deterministic, float64. A target out of reach gives the nearest pose.

Letters: n free joints, m rows of the goals. Metres, world space; rotation vectors in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from avatarrex.signals.limits import LIMITS
from avatarrex.signals.skeleton import PosedSkeleton, Skeleton

METRES_PER_RADIAN = 0.2
"""What a radian of a joint that is to stay turned counts as: a foot's length."""
PRIOR = 0.008
"""Metres that a radian away from the rest prior counts as: it moves a hand that is in reach by less than a millimetre."""
ITERATIONS = 40
STILL = 1e-5
"""Radians: a step below it is the last."""
GAIN = 1e-4
"""A step that takes a smaller share of the sum is the last."""
LOST, REACHED = 0.01, 0.002
"""Metres: a solution that is farther off is tried again from the middle of the limits, and one that is nearer is
taken instead. Out of reach no other can be, and a drag never flips from one such pose to another."""


@dataclass(frozen=True, eq=False)
class Place:
    """The point `offset` (rest axes of `joint`, metres from it) is to be at `target`."""

    joint: int
    target: Float64[np.ndarray, "3"]
    offset: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    weight: float = 1.0

    def point(self, posed: PosedSkeleton) -> Float64[np.ndarray, "3"]:
        """Where it is."""
        return np.asarray(posed.position[self.joint] + posed.rotation[self.joint] @ self.offset)

    def residual(self, posed: PosedSkeleton) -> Float64[np.ndarray, "3"]:
        """Metres to the target."""
        return np.asarray(self.target - self.point(posed))

    def moved(
        self, posed: PosedSkeleton, axes: Float64[np.ndarray, "n 3"], pivots: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        """axis × (p − pivot)."""
        return np.cross(axes, self.point(posed) - pivots)


@dataclass(frozen=True, eq=False)
class Orient:
    """The joint's rotation in the world is to be `target`."""

    joint: int
    target: Float64[np.ndarray, "3 3"]
    weight: float = METRES_PER_RADIAN

    def residual(self, posed: PosedSkeleton) -> Float64[np.ndarray, "3"]:
        """Rotation vector to the target."""
        return np.asarray(Rotation.from_matrix(self.target @ posed.rotation[self.joint].T).as_rotvec())

    def moved(
        self, posed: PosedSkeleton, axes: Float64[np.ndarray, "n 3"], pivots: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        """The axis itself: to first order in the residual."""
        return axes


@dataclass(frozen=True, eq=False)
class Aim:
    """The direction `axis` (rest axes of `joint`, unit) is to point from the joint's point `offset` to `target`."""

    joint: int
    target: Float64[np.ndarray, "3"]
    axis: Float64[np.ndarray, "3"]
    offset: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    weight: float = METRES_PER_RADIAN

    def residual(self, posed: PosedSkeleton) -> Float64[np.ndarray, "3"]:
        """Unit vectors' difference."""
        way = self.target - posed.position[self.joint] - posed.rotation[self.joint] @ self.offset
        return np.asarray(way / max(float(np.linalg.norm(way)), 1e-9) - posed.rotation[self.joint] @ self.axis)

    def moved(
        self, posed: PosedSkeleton, axes: Float64[np.ndarray, "n 3"], pivots: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        """axis × direction."""
        return np.cross(axes, posed.rotation[self.joint] @ self.axis)


Goal = Place | Orient | Aim
"""`residual`: how far it is off, world axes. `moved`: what that loses while joints at pivots turn about world axes, a radian a unit."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Which joints of a skeleton are free, and what they are to reach."""

    skeleton: Skeleton
    free: tuple[int, ...]
    """Joints that may turn."""
    goals: Sequence[Goal]
    stiffness: Float64[np.ndarray, " n"] | None = None
    """How much more each free joint prefers to stay than others; None: all alike."""
    moves: bool = False
    """Whether the root may be moved, too."""
    limited: bool = True
    """Whether joints stay within `LIMITS`, else within a turn of 180° about each axis; those that are beyond already may stay there."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A pose."""

    pose: Float64[np.ndarray, "55 3"]
    translation: Float64[np.ndarray, "3"]
    error: float
    """Metres: of the places the farthest from its target."""


def solve(
    problem: Problem,
    pose: Float64[np.ndarray, "55 3"],
    translation: Float64[np.ndarray, "3"],
    prior: tuple[Float64[np.ndarray, "55 3"], Float64[np.ndarray, "3"]] | None = None,
) -> Solution:
    """The pose that reaches the goals, begun at `pose` and `translation`; `prior`: what it stays near to, else these.

    While a target is dragged the last solution is the next begin and where the drag began is the prior. Joints that are not free
    keep their rotation, also one beyond its limits.
    """
    start = prior or (pose, translation)
    search = _Search(problem, pose, translation, start)
    solution = search.run(search.begin)
    if solution.error < LOST or problem.moves:
        return solution
    other = search.run(search.middle)
    return other if other.error < REACHED else _settled(problem, solution, start)


def _settled(
    problem: Problem, nearest: Solution, prior: tuple[Float64[np.ndarray, "55 3"], Float64[np.ndarray, "3"]]
) -> Solution:
    """Of the poses whose places are where those of `nearest` are, the one nearest to the prior: far from its target a limb is
    not determined about its own axis to the same digits.
    """
    posed = problem.skeleton.turned(nearest.pose, nearest.translation)
    goals = [replace(goal, target=goal.point(posed)) if isinstance(goal, Place) else goal for goal in problem.goals]
    search = _Search(replace(problem, goals=goals), nearest.pose, nearest.translation, prior)
    return replace(search.run(search.begin), error=nearest.error)


class _Search:
    """Numbers x: rotation vectors of the free joints, then the root's place where it may move."""

    def __init__(
        self,
        problem: Problem,
        pose: Float64[np.ndarray, "55 3"],
        translation: Float64[np.ndarray, "3"],
        prior: tuple[Float64[np.ndarray, "55 3"], Float64[np.ndarray, "3"]],
    ) -> None:
        self.problem, self.pose, self.translation = problem, pose, translation
        free = list(problem.free)
        place = np.full((3 * problem.moves, 2), (-np.inf, np.inf))
        turns = LIMITS[free] if problem.limited else np.tile([-np.pi, np.pi], (len(free), 3, 1))
        self.low, self.high = np.concatenate([turns.reshape(-1, 2), place]).T
        self.middle = np.concatenate([turns.mean(-1).ravel(), translation[: 3 * problem.moves]])
        """Of the limits; a root that may move has none."""
        self.begin, self.rest = self._numbers(pose, translation), self._numbers(*prior)
        beyond = np.stack([self.begin, self.rest])
        self.low, self.high = np.minimum(self.low, beyond.min(0)), np.maximum(self.high, beyond.max(0))
        stiffness = np.ones(len(free)) if problem.stiffness is None else problem.stiffness
        self.prior = PRIOR * np.concatenate([np.repeat(stiffness, 3), np.full(3 * problem.moves, 1.0)])
        self.weights = np.repeat([goal.weight for goal in problem.goals], 3)
        ends = sorted({*free, *(goal.joint for goal in problem.goals)})
        self.needed = np.flatnonzero(problem.skeleton.carries[:, ends].any(1)).tolist()

    def run(self, begin: Float64[np.ndarray, " x"]) -> Solution:
        """Damped steps until they are still."""
        x, damping = begin, 1e-3
        posed = self._posed(x)
        off = self._off(x, posed)
        for _ in range(ITERATIONS):
            jacobian = self._jacobian(x, posed)
            normal, gradient = jacobian.T @ jacobian, jacobian.T @ off
            for _ in range(8):
                step = self._step(x, normal, gradient, damping)
                tried = self._posed(x + step)
                left = self._off(x + step, tried)
                if left @ left < off @ off:
                    break
                damping *= 6
            else:
                break
            gained = 1 - (left @ left) / (off @ off)
            x, posed, off, damping = x + step, tried, left, max(damping / 6, 1e-7)
            if np.abs(step).max() < STILL or gained < GAIN:
                break
        places = [goal.residual(posed) for goal in self.problem.goals if isinstance(goal, Place)]
        return Solution(*self._values(x), max((float(np.linalg.norm(each)) for each in places), default=0.0))

    def _step(
        self,
        x: Float64[np.ndarray, " x"],
        normal: Float64[np.ndarray, "x x"],
        gradient: Float64[np.ndarray, " x"],
        damping: float,
    ) -> Float64[np.ndarray, " x"]:
        """The damped step within the limits: numbers that would pass theirs stop there, and the others are solved again."""
        step, going = np.zeros(len(x)), np.ones(len(x), dtype=bool)
        going &= ~((x <= self.low) & (gradient < 0)) & ~((x >= self.high) & (gradient > 0))
        damped = normal + damping * np.diag(normal.diagonal() + 1e-4)
        for _ in range(4):
            if not going.any():
                break
            stopped = ~going
            right = gradient[going] - damped[np.ix_(going, stopped)] @ step[stopped]
            step[going] = np.linalg.solve(damped[np.ix_(going, going)], right)
            wanted = x + step
            beyond = going & ((wanted < self.low) | (wanted > self.high))
            step = np.clip(wanted, self.low, self.high) - x
            if not beyond.any():
                break
            going &= ~beyond
        return step

    def _numbers(
        self, pose: Float64[np.ndarray, "55 3"], translation: Float64[np.ndarray, "3"]
    ) -> Float64[np.ndarray, " x"]:
        turns = pose[list(self.problem.free)].ravel()
        return np.concatenate([turns, translation]) if self.problem.moves else turns

    def _values(self, x: Float64[np.ndarray, " x"]) -> tuple[Float64[np.ndarray, "55 3"], Float64[np.ndarray, "3"]]:
        free = list(self.problem.free)
        pose = self.pose.copy()
        pose[free] = x[: 3 * len(free)].reshape(-1, 3)
        return pose, x[3 * len(free) :].copy() if self.problem.moves else self.translation

    def _posed(self, x: Float64[np.ndarray, " x"]) -> PosedSkeleton:
        return self.problem.skeleton.turned(*self._values(x), self.needed)

    def _off(self, x: Float64[np.ndarray, " x"], posed: PosedSkeleton) -> Float64[np.ndarray, " m"]:
        """What is to become zero: the goals' residuals, then the prior's."""
        goals = np.concatenate([goal.residual(posed) for goal in self.problem.goals])
        return np.concatenate([self.weights * goals, self.prior * (self.rest - x)])

    def _jacobian(self, x: Float64[np.ndarray, " x"], posed: PosedSkeleton) -> Float64[np.ndarray, "m x"]:
        """What `_off` loses with each number."""
        free, skeleton = list(self.problem.free), self.problem.skeleton
        turns = x[: 3 * len(free)].reshape(-1, 3)
        above = np.stack([posed.parent_rotation(joint, skeleton) for joint in free]) if free else np.zeros((0, 3, 3))
        axes = np.swapaxes(above @ left_jacobian(turns), 1, 2).reshape(-1, 3)
        pivots = np.repeat(posed.position[free], 3, axis=0)
        blocks = []
        for goal in self.problem.goals:
            carried: Bool[np.ndarray, " n"] = np.repeat(skeleton.carries[free, goal.joint], 3)
            rows = (goal.moved(posed, axes, pivots) * carried[:, None]).T
            if self.problem.moves:
                rows = np.concatenate([rows, np.eye(3) * isinstance(goal, Place)], 1)
            blocks.append(rows)
        return np.concatenate([self.weights[:, None] * np.concatenate(blocks), np.diag(self.prior)])


def left_jacobian(rotvec: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """J with exp(r + δ) ≈ exp(J δ) exp(r): I + (1 − cos θ)/θ² K + (θ − sin θ)/θ³ K², K = [r]×."""
    angle = np.linalg.norm(rotvec, axis=-1)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    cross = np.zeros((len(rotvec), 3, 3))
    x, y, z = rotvec.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross -= np.swapaxes(cross, 1, 2)
    return np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)
