"""Training frames: the posed person of each frame of a rig, with a stored volume that says where its surface is.

The volume is made by the renderer's own Step I from a copy of the fields that is renewed at every checkpoint: a training
that is resumed there places its samples as it would have without the interruption. Root frame, metres.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig
from avatarrex.counters import Counters
from avatarrex.parts.face import Face, face_state
from avatarrex.parts.part import PartState
from avatarrex.settings import RenderSettings
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.training.core.pixels import training_pairs
from avatarrex.volume.build import AvatarVolume, build_volume

RENDERED = RenderSettings()
SAMPLED = RenderSettings(voxel=0.02, part_voxel=0.005, thin=0)
"""Enough to place samples; hand distances have this resolution while the body is trained."""
KEPT = 256
"""Frames that stay posed: 10 MB each with their volume and hands."""


@dataclass
class TrainingFrame:
    """One frame of a rig."""

    index: int
    posed: PosedPerson
    world_from_root: np.ndarray
    volume: AvatarVolume
    age: int
    """Of the fields that the volume was made from."""

    def states(self) -> dict[str, PartState]:
        """What each part prepared, by name, for one step: colour planes of a trained face are decoded anew in each."""
        return {name: state.apart() for name, state in self.volume.states.items()}

    def camera(self, camera: Camera) -> Camera:
        """A camera of the rig in this frame's root frame."""
        return camera.seen_from(self.world_from_root)


class FrameStore:
    """Posed frames of a rig, the least used forgotten."""

    close: FrameStore | None = None
    """Another rig's, which shows some of the same in sharper pictures."""

    def __init__(self, avatar: Avatar, rig: Rig, trained: str, hidden: frozenset[str], fine: bool = False) -> None:
        """`trained`: `body` or `face`, what changes with age; `fine` makes volumes as they are rendered."""
        self.avatar, self.rig, self.trained = avatar, rig, trained
        self.settings = replace(RENDERED if fine else SAMPLED, hidden=hidden)
        self.age = -1
        self._frames: OrderedDict[int, TrainingFrame] = OrderedDict()
        self._copy = avatar

    def renew(self, age: int) -> None:
        """From now on volumes come from the fields as they are."""
        if self.trained == "body":
            self.avatar.measure_clothing_offset()
        self._copy = replace(self.avatar.frozen_copy(), versions={self.trained: age})
        self.age = age
        if self.close is not None:
            self.close.renew(age)

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """(frame, view) to learn from."""
        return training_pairs(self.rig)

    def drawn(self, rng: np.random.Generator, close: float) -> tuple[FrameStore, int, int]:
        """Store, frame and view of a picture by chance, a share of `close` of the other rig's."""
        if close and self.close is not None and rng.random() < close:
            return self.close.drawn(rng, 0.0)
        return self, *self.pairs[rng.integers(len(self.pairs))]

    def __getitem__(self, index: int) -> TrainingFrame:
        found = self._frames.pop(index, None)
        if found is None:
            found = self._pose(index)
        elif found.age != self.age:
            found = self._again(found)
        self._frames[index] = found
        if len(self._frames) > KEPT:
            self._frames.popitem(last=False)
        return found

    def _pose(self, index: int) -> TrainingFrame:
        signals = self.rig.signals[index]
        avatar = self._copy
        posed = pose_person(avatar.person, signals, Counters(), None)
        volume = build_volume(avatar, posed, self.settings, Counters(), None)
        if self.trained != "face":
            decode_face(avatar, volume)
        return TrainingFrame(index, posed, posed.world_from_root(signals), volume, self.age)

    def _again(self, old: TrainingFrame) -> TrainingFrame:
        """The trained part's volume anew; nothing else has changed."""
        volume = build_volume(self._copy, old.posed, self.settings, Counters(), old.volume)
        return replace(old, volume=volume, age=self.age)


@torch.no_grad()
def decode_face(avatar: Avatar, volume: AvatarVolume) -> None:
    """Decode the colour planes of a face that is not trained, where there is one."""
    face = avatar.parts["face"]
    if "face" in volume.parts:
        assert isinstance(face, Face)
        face.decode_colour(face_state(volume.states), Counters())
