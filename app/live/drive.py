"""What is received for a layer, as it drives the avatar: calibrated, smoothed, kept for a while after the last datagram, then faded out.

Presence: 1 while datagrams come and for `KEEP` seconds after the last; then down to 0 within `FADE`, and up again within `RETURN`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np
from avatarrex_studio.live.received import Neutral, Received
from avatarrex_studio.live.receiver import Counts
from scipy.spatial.transform import Rotation

from avatarrex.signals.driving import Signals
from avatarrex.signals.filters import OneEuro

KEEP, FADE, RETURN = 0.5, 1.0, 0.25
"""Seconds."""
EVERY = 1 / 60
"""Seconds between two frames that are passed on, at least."""
MOST_TAKE = 36_000
"""Frames of a recording: ten minutes."""


@runtime_checkable
class Sender(Protocol):
    """Where something comes from: a port, a camera or a recording."""

    @property
    def where(self) -> str:
        """What the status bar calls it."""

    @property
    def counts(self) -> Counts:
        """What came so far."""

    def latest(self) -> tuple[Received, float]:
        """All that was said last, and when; minus infinity before anything came."""

    def close(self) -> None:
        """End."""


class Drive:
    """One source that is switched on."""

    def __init__(self, sender: Sender) -> None:
        self.sender = sender
        self.neutral = Neutral()
        self.presence = 0.0
        self.signals = Signals.rest()
        self.take: list[tuple[float, Signals]] | None = None
        """Time and signals of every frame while it is recorded."""
        self.title = ""
        """Of its layer, when the recording began: what the user calls it."""
        self.begins = 0.0
        """Seconds of the timeline at which the recording did."""
        self._filter, self._told_at, self._frame_at = OneEuro(), float("-inf"), float("-inf")
        self._turns: np.ndarray | None = None

    def calibrate(self) -> None:
        """The face, the turn of the head and the place of now are neutral."""
        received, _ = self.sender.latest()
        self.neutral = Neutral(dict(received.weights), received.head, received.place)

    def tick(self, now: float) -> bool:
        """Take what came; whether signals or presence are others. At most one frame in `EVERY`."""
        received, came = self.sender.latest()
        passed = now - self._told_at
        if passed < EVERY * 0.9:
            return False
        before = self.presence
        if now - came <= KEEP:
            self.presence = min(before + min(passed, RETURN) / RETURN, 1.0)
        else:
            self.presence = max(before - min(passed, FADE) / FADE, 0.0)
        self._told_at = now
        if came == self._frame_at:
            return self.presence != before
        step, self._frame_at = came - self._frame_at, came
        if step > KEEP:
            self._filter.reset()
            self._turns = None
        if self.neutral.place is None:
            self.neutral = replace(self.neutral, place=received.place)
        self.signals = self._smoothed(self.neutral.applied(received).signals(), min(step, KEEP))
        if self.take is not None and len(self.take) < MOST_TAKE:
            self.take.append((now, self.signals))
        return True

    def _smoothed(self, signals: Signals, seconds: float) -> Signals:
        """One-euro over coefficients, the place and quaternions of one hemisphere."""
        turns = Rotation.from_rotvec(signals.full_pose()).as_quat()
        if self._turns is not None:
            turns *= np.where((turns * self._turns).sum(1, keepdims=True) < 0, -1.0, 1.0)
        values = self._filter(np.concatenate([turns.ravel(), signals.expression, signals.translation]), seconds)
        self._turns, weights, place = values[:220].reshape(55, 4), values[220:272], values[272:]
        pose = Rotation.from_quat(self._turns).as_rotvec()
        return Signals.from_full_pose(pose, expression=np.clip(weights, 0.0, 1.0), translation=place)
