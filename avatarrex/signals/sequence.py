"""A driving sequence: frames at a fixed rate, resampled on the rotations' shortest arcs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import overload

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError, plain
from avatarrex.signals.driving import ROTATIONS, SHAPES, Signals

MOST_FRAMES = 108_000
"""An hour at 30 frames a second; 3 kB of memory each."""


@dataclass(frozen=True)
class SignalSequence:
    """A motion: frames of `Signals`, `fps` a second.

    Iterates and indexes like a tuple of frames; a slice is a sequence again. `at(seconds)` interpolates (rotations on the
    shortest arc), `resample(fps)` changes the rate. Raises `InputError` where there is no frame, or no rate in (0, 1000].
    """

    frames: tuple[Signals, ...]
    fps: float
    name: str = ""
    notes: tuple[str, ...] = field(default=())
    """What the reader decided: axis changes, hand conventions, joints that were not found."""

    def __post_init__(self) -> None:
        if not self.frames:
            raise InputError(self.name or "sequence", "frames", "at least one", 0)
        check_rate(self.fps, self.name or "sequence")
        object.__setattr__(self, "name", plain(self.name))
        object.__setattr__(self, "notes", tuple(plain(note) for note in self.notes))

    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, index: int) -> Signals: ...
    @overload
    def __getitem__(self, index: slice) -> SignalSequence: ...
    def __getitem__(self, index: int | slice) -> Signals | SignalSequence:
        """A frame, or a sequence of some: every fourth of 30 a second plays at 7.5 a second."""
        if isinstance(index, slice):
            return replace(self, frames=self.frames[index], fps=self.fps / abs(index.step or 1))
        return self.frames[index]

    def __iter__(self) -> Iterator[Signals]:
        return iter(self.frames)

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return (len(self.frames) - 1) / self.fps

    def at(self, seconds: float) -> Signals:
        """Interpolated signals at a time, clamped at both ends."""
        place = float(np.clip(seconds * self.fps, 0, len(self.frames) - 1))
        if abs(place - round(place)) < 1e-9:
            return self.frames[round(place)]
        low = int(place)
        high = min(low + 1, len(self.frames) - 1)
        return interpolate(self.frames[low], self.frames[high], place - low)

    def resample(self, fps: float) -> SignalSequence:
        """The same motion at another rate: frame k is the motion at exactly k / fps seconds, up to the last that fits."""
        check_rate(fps, self.name or "sequence")
        # 1e-9: a last frame that falls on a sample is not lost to rounding
        count = int(self.duration * fps * (1 + 1e-9)) + 1
        check_frames(count, self.name or "sequence", "fps")
        return replace(self, frames=tuple(self.at(k / fps) for k in range(count)), fps=fps)


def check_frames(count: int, source: object, field: str) -> None:
    """Raise `InputError` where a motion has more than `MOST_FRAMES` frames; to be called before they are made."""
    if count > MOST_FRAMES:
        raise InputError(source, field, f"at most {MOST_FRAMES:,} frames", f"{count:,}")


def check_rate(value: object, source: object, field: str = "fps") -> float:
    """Frames a second. Raises `InputError` unless `value` is one number (an array of one) above 0, at most 1000."""
    rate = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate <= 1000:
        raise InputError(
            source, field, "a rate above 0, at most 1000", rate.shape if isinstance(rate, np.ndarray) else rate
        )
    return float(rate)


def interpolate(start: Signals, end: Signals, fraction: float) -> Signals:
    """Rotations on the shortest arc (slerp), everything else linearly; `fraction` in [0, 1]."""
    values = {name: (1 - fraction) * getattr(start, name) + fraction * getattr(end, name) for name in SHAPES}
    for name in ROTATIONS:
        a = Rotation.from_rotvec(np.array(getattr(start, name)).reshape(-1, 3))
        b = Rotation.from_rotvec(np.array(getattr(end, name)).reshape(-1, 3))
        turned = a * Rotation.from_rotvec(fraction * (a.inv() * b).as_rotvec())
        values[name] = turned.as_rotvec().reshape(SHAPES[name])
    return Signals(**values)


def stack(poses: np.ndarray, translation: np.ndarray, expression: np.ndarray | None = None) -> tuple[Signals, ...]:
    """Frames from (t, 55, 3) rotvecs, (t, 3) translations and optional (t, 52) coefficients."""
    rows = np.zeros((len(poses), 52)) if expression is None else expression
    return tuple(Signals.from_full_pose(p, translation=t, expression=e) for p, t, e in zip(poses, translation, rows))
