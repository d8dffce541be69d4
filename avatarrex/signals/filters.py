"""Filters over driving signals: an average over neighbouring frames for recordings, one-euro for what comes live.

Rotations are averaged as quaternions of one hemisphere, normalised: within 2 % of the mean on the sphere for turns of a radian.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from avatarrex.signals.sequence import SignalSequence, stack


def smoothed(sequence: SignalSequence, seconds: float) -> SignalSequence:
    """The motion averaged over neighbouring frames, weights a Gaussian with a standard deviation of `seconds`; nothing is delayed."""
    frames = seconds * sequence.fps
    if frames <= 0 or len(sequence) < 2:
        return sequence
    poses = np.stack([frame.full_pose() for frame in sequence])
    turns = np.moveaxis(poses, 0, 1)
    mean = np.stack([_mean_turns(joint, frames) for joint in turns], 1)

    def mean_of(name: str) -> Float64[np.ndarray, "t c"]:
        values = np.stack([getattr(frame, name) for frame in sequence])
        found: Float64[np.ndarray, "t c"] = gaussian_filter1d(values, frames, axis=0, mode="nearest")
        return found

    made = stack(mean, mean_of("translation"), mean_of("expression"))
    shape = sequence[0].shape
    return replace(sequence, frames=tuple(frame.replace(shape=shape) for frame in made) if shape.any() else made)


def continuous(rotations: Float64[np.ndarray, "t 3"]) -> Float64[np.ndarray, "t 4"]:
    """Quaternions of rotation vectors, each in the hemisphere of the one before."""
    turns: Float64[np.ndarray, "t 4"] = Rotation.from_rotvec(rotations).as_quat()
    along = np.sign((turns[1:] * turns[:-1]).sum(1))
    turns[1:] *= np.cumprod(np.where(along == 0, 1.0, along))[:, None]
    return turns


def _mean_turns(rotations: Float64[np.ndarray, "t 3"], frames: float) -> Float64[np.ndarray, "t 3"]:
    if not rotations.any():
        return rotations
    mean = gaussian_filter1d(continuous(rotations), frames, axis=0, mode="nearest")
    found: Float64[np.ndarray, "t 3"] = Rotation.from_quat(mean).as_rotvec()
    return found


class OneEuro:
    """The one-euro filter (Casiez, Roussel and Vogel 2012) on n numbers: much smoothing at rest, little delay in movement.

    A first-order low-pass whose cut-off grows with speed: f = lowest + beta |dx̂/dt|, hertz; the speed itself is filtered at 1 Hz.
    """

    def __init__(self, lowest: float = 1.5, beta: float = 4.0) -> None:
        self.lowest, self.beta = lowest, beta
        self._value: Float64[np.ndarray, " n"] | None = None
        self._speed: Float64[np.ndarray, " n"] | float = 0.0

    def reset(self) -> None:
        """Forget what came before."""
        self._value, self._speed = None, 0.0

    def __call__(self, value: Float64[np.ndarray, " n"], seconds: float) -> Float64[np.ndarray, " n"]:
        """The filtered value, `seconds` after the one before."""
        if self._value is None or seconds <= 0:
            self._value = value if self._value is None else self._value
            return self._value
        before = self._value
        share = _share(1.0, seconds)
        self._speed = share * (value - before) / seconds + (1 - share) * self._speed
        mix = _share(self.lowest + self.beta * np.abs(self._speed), seconds)
        self._value = mix * value + (1 - mix) * before
        return self._value


def _share(frequency: Float64[np.ndarray, " n"] | float, seconds: float) -> Float64[np.ndarray, " n"] | float:
    """Of a new value in a first-order low-pass."""
    turn = 2 * math.pi * frequency * seconds
    return turn / (turn + 1)
