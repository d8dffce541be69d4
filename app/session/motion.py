"""A motion file in the studio: its frames, and which parts of the avatar it drives.

A face recording leaves the body as it was posed, a body recording leaves the face: what a file never moves stays the
user's. The body's shape belongs to the avatar and is never driven.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from avatarrex_studio.session.posing import SLOTS, numbers
from avatarrex_studio.session.timeline import BODY, PARTS, Clip, Layer
from avatarrex_studio.session.timeline_commands import AddLayer, LoadMotion

from avatarrex.signals.fbx import SECONDS
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.read import import_motion
from avatarrex.signals.sequence import SignalSequence

WHOLE = ("root", *BODY, "head")
"""What a motion drives as a whole where it moves more than the head, at rest where it says nothing of a joint."""
HANDS = ("left hand", "right hand")
OVER = {"wave": ("right arm", "right hand", "lids", "upper face", "mouth")}
"""What a motion of the program drives as a layer over others, where that is not all that it moves."""


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
    def parts(self) -> tuple[str, ...]:
        """What the motion drives, of `PARTS`: each all of it, so that nothing of a motion before is left.

        Hands that keep one shape while the rest moves are none that it moves.
        """
        values = np.stack([numbers(frame) for frame in self.sequence])
        present, changes = (values != 0).any(0), (values != values[0]).any(0)
        found = {part for part, names in PARTS.items() if any(present[SLOTS[name]].any() for name in names)}
        if changes.any():
            found -= {hand for hand in HANDS if not any(changes[SLOTS[name]].any() for name in PARTS[hand])}
        found |= set(WHOLE) if found & {"root", *BODY} else set()
        return tuple(part for part in PARTS if part in found)

    @property
    def over(self) -> tuple[str, ...]:
        """What it drives as a layer over others."""
        return OVER.get(self.path, self.parts)

    @property
    def clip(self) -> Clip:
        """What a layer of it names."""
        name, rate = Path(self.path).name, float(self.sequence.fps)
        return Clip(self.path, name, len(self), rate, self.imported.options)

    def loaded(self) -> LoadMotion:
        """The command that loads this motion."""
        clip = self.clip
        return LoadMotion(clip.path, clip.name, clip.frames, clip.fps, clip.options, self.parts)

    def layer(self) -> AddLayer:
        """The command that adds this motion over all layers."""
        return AddLayer(Layer(self.clip.name, self.clip, parts=frozenset(self.over)))


def driven_words(parts: Collection[str]) -> str:
    """What is driven, as a person says it: `the whole body, lids and mouth`."""
    whole = set(WHOLE) <= set(parts)
    said = (["the whole body"] if whole else []) + [
        part for part in PARTS if part in parts and not (whole and part in WHOLE)
    ]
    return " and ".join((", ".join(said[:-1]), said[-1])) if len(said) > 1 else (said or ["nothing"])[0]
