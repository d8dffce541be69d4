"""What a live source says at one moment, in our names and axes, and the driving signals that it is.

Coefficients 0 to 1 by Apple's names; rotation vectors by our joints, radians; the head's turn, which neck and head share; metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES

APPLE = {name.lower(): name for name in EXPRESSION_NAMES}
"""Apple's names by their lower case: sources begin them with a capital or not."""


@dataclass(frozen=True)
class Received:
    """Of one datagram, or of all since the source began."""

    weights: Mapping[str, float] = field(default_factory=dict)
    turns: Mapping[str, Float64[np.ndarray, "3"]] = field(default_factory=dict)
    head: Float64[np.ndarray, "3"] | None = None
    place: Float64[np.ndarray, "3"] | None = None
    """Of the pelvis, from wherever the source counts: what was said first is where it rests."""

    def over(self, before: Received) -> Received:
        """With what only `before` says: sources that send a bone at a time."""
        return Received(
            {**before.weights, **self.weights},
            {**before.turns, **self.turns},
            before.head if self.head is None else self.head,
            before.place if self.place is None else self.place,
        )

    def signals(self) -> Signals:
        """Everything that is not said is at rest."""
        pose = np.zeros((55, 3))
        for joint, turn in self.turns.items():
            pose[JOINT_NAMES.index(joint)] = turn
        if self.head is not None:
            pose[[JOINT_NAMES.index("neck"), JOINT_NAMES.index("head")]] = self.head / 2
        expression = np.array([self.weights.get(name, 0.0) for name in EXPRESSION_NAMES])
        place = np.zeros(3) if self.place is None else self.place
        return Signals.from_full_pose(pose, expression=np.clip(expression, 0.0, 1.0), translation=place)


@dataclass(frozen=True)
class Neutral:
    """The face, the turn of the head and the place of the pelvis that count as neutral."""

    weights: Mapping[str, float] = field(default_factory=dict)
    head: Float64[np.ndarray, "3"] | None = None
    place: Float64[np.ndarray, "3"] | None = None

    def applied(self, received: Received) -> Received:
        """A coefficient w with the neutral one n becomes (w − n) / (1 − n); head and pelvis go from the neutral ones on."""
        weights = {
            name: max(value - self.weights.get(name, 0.0), 0.0) / max(1.0 - self.weights.get(name, 0.0), 0.05)
            for name, value in received.weights.items()
        }
        head = received.head
        if head is not None and self.head is not None:
            head = (Rotation.from_rotvec(self.head).inv() * Rotation.from_rotvec(head)).as_rotvec()
        place = received.place
        if place is not None and self.place is not None:
            place = place - self.place
        return Received(weights, received.turns, head, place)


def from_unity(quaternion: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "3"]:
    """A rotation of Unity's axes (left-handed, x to the person's right; x y z w) as a rotation vector of ours: x is turned over."""
    x, y, z, w = quaternion
    turned: Float64[np.ndarray, "3"] = Rotation.from_quat([x, -y, -z, w]).as_rotvec()
    return turned


def finite(values: Float64[np.ndarray, " n"], largest: float) -> Float64[np.ndarray, " n"]:
    """The same. Raises `ValueError` where one is not finite, or beyond `largest`."""
    if not (np.isfinite(values).all() and (np.abs(values) <= largest).all()):
        raise ValueError(f"numbers up to {largest:g} expected")
    return values
