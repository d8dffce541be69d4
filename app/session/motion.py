"""A motion file in the studio: its frames, and which signals it drives.

A face recording leaves the body as it was posed, a body recording leaves the face: what a file never moves stays the
user's. The body's shape belongs to the avatar and is never driven.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from avatarrex_studio.session.commands import LoadMotion, SetFrame

from avatarrex.signals.driving import SHAPES, Signals
from avatarrex.signals.fbx import SECONDS
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.read import import_motion
from avatarrex.signals.sequence import SignalSequence

WHOLES = (
    ("global_orient", "translation", "body_pose"),
    ("left_hand_pose",),
    ("right_hand_pose",),
    ("expression",),
    ("jaw_pose",),
    ("eye_pose",),
)
"""Fields of `Signals` that a motion drives together, at rest where it says nothing of a joint."""


@dataclass(frozen=True)
class Motion:
    """A sequence with the path it came from."""

    path: str
    """Or the name of a motion that comes with the program."""
    imported: ImportedMotion

    @classmethod
    def read(cls, path: str | Path, options: ImportOptions | None = None, fbx_seconds: float = SECONDS) -> Motion:
        """Read any kind of motion file, guesses replaced by `options`, an `.fbx` in `fbx_seconds`. Raises `InputError`."""
        return cls(str(path), import_motion(path, options, fbx_seconds))

    @property
    def sequence(self) -> SignalSequence:
        """The frames."""
        return self.imported.sequence

    def __len__(self) -> int:
        return len(self.sequence)

    @cached_property
    def masks(self) -> dict[str, np.ndarray]:
        """Per field of `Signals` but the shape: which joints or entries leave rest in some frame."""
        masks = {}
        for name in SHAPES:
            if name != "shape":
                moved = np.any([getattr(frame, name) != 0 for frame in self.sequence], axis=0)
                joints = name.endswith("pose") and moved.ndim == 2
                masks[name] = np.broadcast_to(moved.any(-1, keepdims=True), moved.shape) if joints else moved
        return masks

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of the fields that the motion moves."""
        return tuple(name for name, mask in self.masks.items() if mask.any())

    def signals(self, frame: int, base: Signals) -> Signals:
        """`base` with what the motion drives, at `frame`: each of `WHOLES` all of it, so that nothing of a motion before is left."""
        source, driven = self.sequence[frame], set(self.driven)
        wholes = [whole for whole in WHOLES if driven & set(whole)]
        return base.replace(**{name: getattr(source, name) for whole in wholes for name in whole})

    def loaded(self, base: Signals) -> LoadMotion:
        """The command that loads this motion."""
        name = Path(self.path).name
        rate, options = float(self.sequence.fps), self.imported.options
        return LoadMotion(self.path, name, len(self), rate, self.signals(0, base), options)

    def at(self, frame: int, base: Signals) -> SetFrame:
        """The command that goes to `frame`."""
        return SetFrame(frame, self.signals(frame, base))
