"""How the avatar moves before anybody has done anything: it breathes, its weight sways, it looks about and blinks.

Shown, not done: neither the state nor the journal knows of it. It ends for good at the first thing that somebody does, or after `LASTS`
seconds, for a window that nobody looks at should cost nothing.
"""

from __future__ import annotations

import numpy as np
from avatarrex_studio.session.state import StudioState

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES

LASTS, EASE = 30.0, 0.5
"""Seconds; the second of growing at first and of fading at the end."""
BREATH, SWAY, LOOK, BLINK = 4.2, 6.5, 9.0, 3.7
"""Seconds of a period each."""
SHUT = 0.18
"""Seconds of a blink."""
TURNS: dict[str, tuple[tuple[float, float, float], float, float]] = {
    "spine1": ((0.0, 0.0, 0.9), SWAY, 0.0), "spine2": ((1.0, 0.0, 0.0), BREATH, 0.0), "spine3": ((-1.4, 0.5, -0.5), BREATH, 0.1),
    "neck": ((0.5, 0.0, -0.4), BREATH, 0.25), "head": ((0.8, 3.2, 0.6), LOOK, 0.1), "left_collar": ((0.0, 0.0, 0.8), BREATH, 0.05),
    "right_collar": ((0.0, 0.0, -0.8), BREATH, 0.05), "left_shoulder": ((0.0, 0.8, -0.9), BREATH, 0.1),
    "right_shoulder": ((0.0, -0.8, 0.9), BREATH, 0.1), "left_elbow": ((0.0, -1.6, 0.0), SWAY, 0.2),
    "right_elbow": ((0.0, 1.6, 0.0), SWAY, 0.3),
}  # fmt: skip
"""Degrees that a joint turns to either side, the period, and how much of it a joint is behind."""


class Greeting:
    """From the moment it is made; times in seconds of the caller's clock."""

    def __init__(self, now: float) -> None:
        self._begun = now
        self._ended = now + LASTS

    def stop(self, now: float) -> None:
        """Somebody did something."""
        self._ended = min(self._ended, now)

    def strength(self, now: float) -> float:
        """0 to 1; 0 once it is over."""
        return float(np.clip(min((now - self._begun) / EASE, (self._ended - now) / EASE + 1), 0, 1))

    def over(self, now: float) -> bool:
        """Whether nothing moves any more."""
        return now >= self._ended + EASE

    def shown(self, state: StudioState, now: float) -> StudioState:
        """The state as it is drawn; the very same once it is over."""
        return (
            state
            if self.over(now)
            else state.change(signals=swayed(state.signals, now - self._begun, self.strength(now)))
        )


def swayed(signals: Signals, seconds: float, strength: float) -> Signals:
    """Signals a little moved, `strength` from 0 to 1."""
    pose, face = signals.body_pose.copy(), signals.expression.copy()
    for name, (turn, period, behind) in TURNS.items():
        pose[JOINT_NAMES.index(name) - 1] += (
            strength * np.sin(2 * np.pi * (seconds / period - behind)) * np.radians(turn)
        )
    shut = strength * max(0.0, 1 - abs(seconds % BLINK - SHUT) / SHUT)
    for name in ("eyeBlinkLeft", "eyeBlinkRight"):
        face[EXPRESSION_NAMES.index(name)] = max(face[EXPRESSION_NAMES.index(name)], shut)
    return signals.replace(body_pose=pose, expression=face)
