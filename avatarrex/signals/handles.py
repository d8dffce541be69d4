"""What of a person can be grabbed: hands, feet, head, pelvis, elbows and knees, and which joints follow them.

    pulled(skeleton, signals, Pull("left_hand", target))    turned(skeleton, signals, ("left_knee",), pins)
    looking(skeleton, signals, target)

Pinned handles stay where they are while another is pulled or a joint is turned, as far as limbs reach; pinned hands and feet stay
turned, too. A pinned foot stays flat; where its ankle is at its limit the heel lifts, and it stands on its ball with level toes.
Metres, world space.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

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
"""Metres a radian: how much a pinned hand or foot wants to stay turned as it is."""
HEEL = 0.05
"""Weight of the ankle of a foot that stands on its ball against the pulled place: the heel lifts before the pelvis stops."""
LIFTS = 0.001
"""Metres that the ball of a foot would leave its place by, its ankle at the limit, before the heel lifts."""
ROOT = "translation"
"""Beside the joints that are free: the root may be moved."""
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
    ball: str = ""
    """The joint on which it stands while it is pinned; none: the handle itself stays."""

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
        f"{side}_foot": Handle(f"{side}_ankle", leg, (1.0, 1.0), end=f"{side}_ankle", level=SOLE, ball=f"{side}_foot"),
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
    pins, target = pins - {pull.handle}, np.asarray(pull.target, np.float64)
    target = _within_reach(skeleton, posed, taken, target) if taken.follow else _above(skeleton, posed, pins, target)
    goals: list[Goal] = [Place(taken.index, target, taken.offset(skeleton))]
    free = dict(zip(taken.follow or (ROOT,), taken.stiffness or (1.0,)))
    if taken.level:
        free[taken.end] = WILLING
        goals.append(Orient(JOINT_NAMES.index(taken.end), posed.rotation[JOINT_NAMES.index(taken.end)], taken.level))
    moving = [JOINT_NAMES.index(name) for name in taken.follow or (taken.joint,)]

    def solved(tiptoe: frozenset[str], begin: Signals) -> Signals:
        kept, following = _pinned(skeleton, posed, pins, moving, tiptoe)
        return _solved(skeleton, begin, start, [*goals, *kept], following | free, limited)

    return _standing(skeleton, posed, pins, solved, signals)


def turned(
    skeleton: Skeleton,
    signals: Signals,
    joints: tuple[str, ...],
    pins: frozenset[str],
    prior: Signals,
    limited: bool = True,
) -> Signals:
    """`signals`, in which somebody has turned `joints` (the pelvis: or moved it), with the pins where they are in `prior`.

    What carries them follows; the joints stay as they were turned. Where one of them is of a pinned limb itself the root follows, too.
    The very same signals where no pin is carried by them.
    """
    posed, moving = skeleton.posed(prior), [JOINT_NAMES.index(name) for name in joints]
    limbs = {name for pin in map(handle, pins) for name in (*pin.follow, pin.end if pin.ball else "")}
    own = bool(limbs.intersection(joints))

    def solved(tiptoe: frozenset[str], begin: Signals) -> Signals:
        kept, following = _pinned(skeleton, posed, pins, [0] if own else moving, tiptoe)
        free = {name: stiffness for name, stiffness in following.items() if name not in joints} | (
            {ROOT: 1.0} if own else {}
        )
        goals = [goal for goal in kept if not (isinstance(goal, Orient) and goal.joint in moving)]
        return _solved(skeleton, begin, prior, goals, free, limited) if goals and free else begin

    return _standing(skeleton, posed, pins, solved, signals)


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


def _above(
    skeleton: Skeleton, posed: PosedSkeleton, pins: frozenset[str], target: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "3"]:
    """The pelvis' place nearest to the target from which straight legs reach the feet that are pinned."""
    feet = [handle(name) for name in sorted(pins) if handle(name).ball]
    for _ in range(8 * len(feet)):  # onto one sphere after the other: two feet apart need few rounds
        foot = feet[0]
        feet = [*feet[1:], foot]
        hip, knee = (JOINT_NAMES.index(name) for name in foot.follow)
        reach = float(np.linalg.norm(np.diff(skeleton.joints[[hip, knee, foot.index]], axis=0), axis=1).sum())
        way = target + posed.position[hip] - posed.position[0] - posed.position[foot.index]
        target = target + way * min(reach / max(float(np.linalg.norm(way)), 1e-9) - 1, 0.0)
    return target


def _standing(
    skeleton: Skeleton,
    posed: PosedSkeleton,
    pins: frozenset[str],
    solved: Callable[[frozenset[str], Signals], Signals],
    signals: Signals,
) -> Signals:
    """`solved` with pinned feet flat where they are in `posed`; those that would not stay flat once more, on their balls."""
    flat = solved(frozenset(), signals)
    after = skeleton.posed(flat)
    balls = {name: JOINT_NAMES.index(HANDLES[name].ball) for name in pins if HANDLES[name].ball}
    lifted = {name for name, ball in balls.items() if np.linalg.norm((after.position - posed.position)[ball]) > LIFTS}
    return solved(frozenset(lifted), flat) if lifted else flat


def _pinned(
    skeleton: Skeleton, posed: PosedSkeleton, pins: frozenset[str], moving: list[int], tiptoe: frozenset[str]
) -> tuple[list[Goal], dict[str, float]]:
    """What keeps the pins that the joints `moving` carry where they are, feet of `tiptoe` by their balls, and which joints follow,
    with their stiffness.
    """
    goals: list[Goal] = []
    free: dict[str, float] = {}
    for name in sorted(pins):
        pinned = handle(name)
        if not skeleton.carries[moving, pinned.index].any():
            continue
        free = dict(zip(pinned.follow, pinned.stiffness)) | free
        point = Place(pinned.index, np.zeros(3), pinned.offset(skeleton))
        goals.append(replace(point, target=point.point(posed), weight=HEEL if name in tiptoe else FIRM))
        if pinned.end:
            end = JOINT_NAMES.index(pinned.end)
            goals.append(Orient(end, posed.rotation[end], FLAT))
            free.setdefault(pinned.end, WILLING)
        if name in tiptoe:
            ball = JOINT_NAMES.index(pinned.ball)
            goals += [Place(ball, posed.position[ball], weight=FIRM), Orient(ball, posed.rotation[ball], FLAT)]
            free.setdefault(pinned.ball, WILLING)
    return goals, free


def _solved(
    skeleton: Skeleton, signals: Signals, start: Signals, goals: list[Goal], free: Mapping[str, float], limited: bool
) -> Signals:
    names, moves = sorted(free.keys() - {ROOT}, key=JOINT_NAMES.index), ROOT in free
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
