"""A drag of a handle or of the gaze: what was there when it began, and the command that a new place of it gives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from avatarrex_studio.session.commands import Command, Followed, LookAt, PullHandle, SetJoint, SetShape
from avatarrex_studio.session.posing import counterpart
from avatarrex_studio.session.state import StudioState, vector
from jaxtyping import Float64

from avatarrex.signals.driving import Signals
from avatarrex.signals.handles import FORWARD, GAZE, HANDLES, Pull, looking, place, pulled, turned
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.skeleton import PosedSkeleton, Skeleton
from avatarrex.templates.figure import Figure
from avatarrex.templates.model import TemplateModel

LOOK = "gaze"
"""The point that the eyes look at, beside `HANDLES`."""
BEFORE = 0.45
"""Metres before the eyes at which the gaze is dragged."""
EXTREMITIES = ("left_hand", "right_hand", "left_foot", "right_foot", "head")
"""Handles that are taken by their skin, too."""
LOOKING = ("head", "neck", *GAZE)
"""What, when it is selected, shows the gaze."""


@dataclass(frozen=True, eq=False)
class Grip:
    """A handle in somebody's hand."""

    name: str
    """Of `HANDLES`, or `LOOK`."""
    skeleton: Skeleton
    start: Signals
    """Of when the drag began: pins stay as they were then."""

    def to(self, state: StudioState, target: Float64[np.ndarray, "3"]) -> Command:
        """The command for a target in the world, metres."""
        limited, goal = state.limit_joints, vector(target)
        if self.name == LOOK:
            return LookAt(goal, looking(self.skeleton, state.signals, target, self.start, limited))
        pull = Pull(self.name, target)
        followed = pulled(self.skeleton, state.signals, pull, state.tools.pins, self.start, limited)
        return PullHandle(self.name, goal, followed)


class Beginning:
    """What was there when the drag of a slider or ring began, whatever its commands have become: keys, frames in between."""

    def __init__(self) -> None:
        self._drag: object = None
        self._start = Signals.rest()

    def of(self, gesture: object, state: StudioState) -> Signals:
        """The signals at the first command of a gesture; those of `state` where it is the first, or none (None)."""
        drag = (gesture, state.slot, state.tools.pins)
        if gesture is None or drag != self._drag:
            self._drag, self._start = drag, state.signals
        return self._start


def stood(command: SetShape, state: StudioState, body: TemplateModel) -> SetShape:
    """The command with the rise after which the lowest point of `body` is as high as in the `state` that it is applied to."""
    before, after = state.signals, replace(command, rise=0.0).apply(state).signals
    low, other = (float(Figure(body, signals).vertices[:, 1].min()) for signals in (before, after))
    return replace(command, rise=low - other)


def followed(command: Followed, state: StudioState, skeleton: Skeleton, start: Signals) -> Command:
    """The command with what follows it so that pins stay where they were in `start`, of when the drag of a slider or ring began."""
    joints: tuple[str, ...] = ("pelvis",)
    if isinstance(command, SetJoint):
        joints = (command.joint, counterpart(command.joint)) if command.linked else (command.joint,)
    after = replace(command, signals=None).apply(state).signals
    signals = turned(skeleton, after, joints, state.tools.pins, start, state.limit_joints)
    return command if signals is after else replace(command, signals=signals)


def places(skeleton: Skeleton, posed: PosedSkeleton, selected: str | None) -> dict[str, Float64[np.ndarray, "3"]]:
    """Where everything is that can be dragged, world metres; the gaze where something is `selected` that looks."""
    found = {name: place(skeleton, posed, name) for name in HANDLES}
    if selected in LOOKING:
        eyes = [JOINT_NAMES.index(eye) for eye in GAZE]
        ahead = (posed.rotation[eyes] @ FORWARD).mean(0)
        found[LOOK] = posed.position[eyes].mean(0) + BEFORE * ahead
    return found


def handle_of(name: str | None) -> str | None:
    """The handle whose joint a part belongs to: a finger's is the hand, a region's the head; None where there is none."""
    if name is None:
        return None
    side, _, part = name.partition("_")
    if side in ("left", "right") and part.rstrip("123") in ("wrist", "index", "middle", "ring", "pinky", "thumb"):
        return f"{side}_hand"
    found = {handle.joint: key for key, handle in HANDLES.items()}
    found.update({f"{each}_foot": f"{each}_foot" for each in ("left", "right")})
    return found.get(name, "head" if name not in JOINT_NAMES or name in (*LOOKING, "jaw") else None)
