"""What of a person can be grabbed: hands, feet, head, pelvis, elbows and knees, and which joints follow them.

    pulled(skeleton, signals, Pull("left_hand", target))    looking(skeleton, signals, target)

Pinned handles stay where they are while another is pulled, as far as limbs reach; pinned hands and feet stay turned, too.
Metres, world space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.ik import Aim, Goal, Orient, Place, Problem, solve
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.skeleton import PosedSkeleton, Skeleton

FIRM = 30.0
"""Weight of a pinned place against the pulled one: a pelvis pulled 30 cm too high moves a pinned foot by less than a millimetre."""
FLAT = 0.05
"""Metres a radian: how much a pinned hand or foot wants to stay turned as it is: where an ankle is at its limit the heel lifts."""
SOLE, UPRIGHT = 0.012, 0.02
"""The same of a foot and of a head that are pulled, so that soles stay level and the spine bends."""
STIFF, WILLING = 3.0, 0.3
"""Stiffness of what moves less (collars, the trunk, whose joints share a bend), and of the joint that stays turned."""
EYES, FACE = 0.2, 0.012
"""Weights of the eyes' directions and of the face's: the head turns about two thirds of the way."""
FORWARD = np.array([0.0, 0.0, 1.0])
"""Where eyes and face look at rest."""
GAZE = ("left_eye", "right_eye")


@dataclass(frozen=True)
class Handle:
    """A point of a person that can be pulled."""

    joint: str
    follow: tuple[str, ...] = ()
    """Joints that turn."""
    stiffness: tuple[float, ...] = ()
    """Of each of them, against 1."""
    end: str = ""
    """The joint that keeps a pinned end turned as it is."""
    level: float = 0.0
    """How much `end` keeps its direction while the handle is pulled, metres a radian."""
    between: tuple[str, ...] = ()
    """Joints whose middle at rest is the handle; none: the joint itself."""

    def offset(self, skeleton: Skeleton) -> Float64[np.ndarray, "3"]:
        """From the joint, rest axes."""
        if not self.between:
            return np.zeros(3)
        middle = np.mean([skeleton.joints[JOINT_NAMES.index(name)] for name in self.between], 0)
        return np.asarray(middle - skeleton.joints[self.index])

    @property
    def index(self) -> int:
        """Of its joint."""
        return JOINT_NAMES.index(self.joint)


def _sided(side: str) -> dict[str, Handle]:
    arm, leg = (
        tuple(f"{side}_{name}" for name in names) for names in (("collar", "shoulder", "elbow"), ("hip", "knee"))
    )
    return {
        f"{side}_hand": Handle(f"{side}_wrist", arm, (STIFF, 1.0, 1.0), end=f"{side}_wrist"),
        f"{side}_foot": Handle(f"{side}_ankle", leg, (1.0, 1.0), end=f"{side}_ankle", level=SOLE),
        f"{side}_elbow": Handle(f"{side}_elbow", arm[:2], (STIFF, 1.0)),
        f"{side}_knee": Handle(f"{side}_knee", leg[:1], (1.0,)),
    }


_TRUNK = ("spine1", "spine2", "spine3", "neck", "head")
HANDLES: dict[str, Handle] = {
    **_sided("left"),
    **_sided("right"),
    "head": Handle("head", _TRUNK, (STIFF,) * len(_TRUNK), end="head", level=UPRIGHT, between=GAZE),
    "pelvis": Handle("pelvis"),
}
"""By name. The pelvis moves the whole person."""


@dataclass(frozen=True, eq=False)
class Pull:
    """A handle by name, and where it is pulled to."""

    handle: str
    target: Float64[np.ndarray, "3"]


def handle(name: str) -> Handle:
    """The handle of that name. Raises `InputError`."""
    if name not in HANDLES:
        raise InputError("handle", "", " or ".join(HANDLES), name)
    return HANDLES[name]


def place(skeleton: Skeleton, posed: PosedSkeleton, name: str) -> Float64[np.ndarray, "3"]:
    """Where a handle is, world metres. Raises `InputError` for another name."""
    found = handle(name)
    return Place(found.index, np.zeros(3), found.offset(skeleton)).point(posed)


def pulled(
    skeleton: Skeleton,
    signals: Signals,
    pull: Pull,
    pins: frozenset[str] = frozenset(),
    prior: Signals | None = None,
    limited: bool = True,
) -> Signals:
    """`signals` with the handle at its target, or as near as limits let it be.

    `prior`: the signals that the drag began with, whose pins stay and which what is not determined stays near to; else
    `signals`. Raises `InputError` for an unknown handle.
    """
    taken, start = handle(pull.handle), prior or signals
    posed = skeleton.posed(start)
    target = _within_reach(skeleton, posed, taken, np.asarray(pull.target, np.float64))
    goals: list[Goal] = [Place(taken.index, target, taken.offset(skeleton))]
    free = dict(zip(taken.follow, taken.stiffness))
    if taken.level:
        free[taken.end] = WILLING
        goals.append(Orient(JOINT_NAMES.index(taken.end), posed.rotation[JOINT_NAMES.index(taken.end)], taken.level))
    moving = [JOINT_NAMES.index(name) for name in taken.follow or (taken.joint,)]
    for name in sorted(pins - {pull.handle}):
        pinned = handle(name)
        if not skeleton.carries[moving, pinned.index].any():
            continue
        point = Place(pinned.index, np.zeros(3), pinned.offset(skeleton)).point(posed)
        goals.append(Place(pinned.index, point, pinned.offset(skeleton), FIRM))
        for joint, stiffness in zip(pinned.follow, pinned.stiffness):
            free.setdefault(joint, stiffness)
        if pinned.end:
            goals.append(Orient(JOINT_NAMES.index(pinned.end), posed.rotation[JOINT_NAMES.index(pinned.end)], FLAT))
            free.setdefault(pinned.end, WILLING)
    return _solved(skeleton, signals, start, goals, free, limited)


def looking(
    skeleton: Skeleton,
    signals: Signals,
    target: Float64[np.ndarray, "3"],
    prior: Signals | None = None,
    limited: bool = True,
) -> Signals:
    """`signals` with eyes, head and neck turned so that the eyes look at `target`, as far as limits let them."""
    target = np.asarray(target, np.float64)
    face = HANDLES["head"]
    goals: list[Goal] = [Aim(JOINT_NAMES.index(eye), target, FORWARD, weight=EYES) for eye in GAZE]
    goals.append(Aim(face.index, target, FORWARD, face.offset(skeleton), FACE))
    free = {"neck": 1.0, "head": 1.0, **dict.fromkeys(GAZE, WILLING)}
    return _solved(skeleton, signals, prior or signals, goals, free, limited)


def _within_reach(
    skeleton: Skeleton, posed: PosedSkeleton, taken: Handle, target: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "3"]:
    """The place nearest to the target that the limb's lengths allow: straight, or folded as far as they differ."""
    if not taken.follow:
        return target
    chain, joint = [], taken.index
    first = JOINT_NAMES.index(taken.follow[0])
    while joint != first:
        chain.append(float(np.linalg.norm(skeleton.joints[joint] - skeleton.joints[skeleton.parents[joint]])))
        joint = skeleton.parents[joint]
    chain.append(float(np.linalg.norm(taken.offset(skeleton))))
    way = target - posed.position[first]
    distance = max(float(np.linalg.norm(way)), 1e-9)
    allowed = np.clip(distance, max(0.0, 2 * max(chain) - sum(chain)), sum(chain))
    return np.asarray(posed.position[first] + way * allowed / distance)


def _solved(
    skeleton: Skeleton, signals: Signals, start: Signals, goals: list[Goal], free: Mapping[str, float], limited: bool
) -> Signals:
    names = sorted(free, key=JOINT_NAMES.index)
    moves = any(isinstance(goal, Place) and goal.joint == 0 for goal in goals)
    problem = Problem(
        skeleton,
        tuple(map(JOINT_NAMES.index, names)),
        goals,
        np.array([free[name] for name in names]),
        moves,
        limited,
    )
    solution = solve(
        problem, signals.full_pose(), signals.translation, (start.full_pose(), np.asarray(start.translation))
    )
    return Signals.from_full_pose(
        solution.pose, translation=solution.translation, expression=signals.expression, shape=signals.shape
    )
