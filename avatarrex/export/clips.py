"""Motions as animation clips: rotations as continuous quaternions, the pelvis' place, weights of the morph targets.

Whatever skeleton a motion file has, its reader made it `Signals` of our 55 joints, or refused it by name.
Letters: t frames, j joints, e expressions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.signals.read import read_motion
from avatarrex.signals.sequence import SignalSequence


@dataclass(frozen=True, eq=False)
class Clip:
    """A named motion."""

    name: str
    sequence: SignalSequence

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def times(self) -> Float64[np.ndarray, " t"]:
        """Seconds of the frames."""
        return np.arange(len(self)) / self.sequence.fps

    def rotations(self) -> Float64[np.ndarray, "t j 4"]:
        """Quaternions xyzw of the joints about their rest axes: each the nearer of its two signs to the frame before."""
        pose = np.stack([frame.full_pose() for frame in self.sequence])
        turned = Rotation.from_rotvec(pose.reshape(-1, 3)).as_quat().reshape(*pose.shape[:2], 4)
        turned[0] *= np.where(turned[0, :, 3:] < 0, -1.0, 1.0)
        flips = np.sign((turned[1:] * turned[:-1]).sum(-1))
        flips[flips == 0] = 1
        turned[1:] *= np.cumprod(flips, 0)[..., None]
        return np.asarray(turned)

    def translations(self) -> Float64[np.ndarray, "t 3"]:
        """Metres that the pelvis is moved."""
        return np.stack([frame.translation for frame in self.sequence])

    def expressions(self) -> Float64[np.ndarray, "t e"]:
        """Weights of the morph targets."""
        return np.stack([frame.expression for frame in self.sequence])


def read_clips(motions: Sequence[str | Path], poses: Sequence[str] = ()) -> tuple[Clip, ...]:
    """A clip of each motion file, called as the file, and of each named pose, one frame long; the body's shape is the avatar's.

    Raises `InputError`.
    """
    clips = [Clip(Path(path).stem, _of_mean_shape(read_motion(path))) for path in motions]
    for pose in poses:
        still = Signals.rest().replace(body_pose=named_pose(pose))
        clips.append(Clip(pose, SignalSequence((still,), 30.0, pose)))
    return _named_apart(clips)


def _of_mean_shape(sequence: SignalSequence) -> SignalSequence:
    mean = np.zeros(10)
    return replace(
        sequence, frames=tuple(frame.replace(shape=mean) if frame.shape.any() else frame for frame in sequence)
    )


def _named_apart(clips: Sequence[Clip]) -> tuple[Clip, ...]:
    """A second clip of a name gets a number."""
    seen: dict[str, int] = {}
    named = []
    for clip in clips:
        seen[clip.name] = seen.get(clip.name, 0) + 1
        number = seen[clip.name]
        named.append(clip if number == 1 else Clip(f"{clip.name}_{number}", clip.sequence))
    return tuple(named)
