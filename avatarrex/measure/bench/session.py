"""What the stages of one run share: the avatar, how much to do, and what one stage found that another needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.synthetic.subject import Subject, load_subject
from avatarrex.counters import Counters
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.signals.sequence import interpolate
from avatarrex.templates.posed import PosedPerson, pose_person

Made = TypeVar("Made")
SEED = 7
WAY = ("stand", "wave", "walk", "squat", "dance")
"""Poses that the moving sequence passes."""
FRAMES_BETWEEN = 8
"""Frames from one pose of `WAY` to the next: at 24 Hz a third of a second."""


@dataclass
class Bench:
    """One run."""

    quick: bool = False
    """Fewer points, rays and repeats: two minutes on two quiet cores in place of ten."""
    source: str | Path = "default"
    """The avatar."""
    capture: Path | None = None
    """What a training step is tried on; a synthetic one is made where there is none."""
    scale: float = 1.0
    """Of every count of points, rays, pixels: tests run the stages small."""
    device: str = "cpu"
    """Where the networks of whole frames run."""
    absent: dict[str, str] = field(default_factory=dict)
    """What could not be measured, by name, and why."""
    _made: dict[str, Any] = field(default_factory=dict)

    def once(self, make: Callable[[Bench], Made]) -> Made:
        """What `make` gives for this run; made on the first call."""
        key = f"{make.__module__}.{make.__qualname__}"
        if key not in self._made:
            self._made[key] = make(self)
        found: Made = self._made[key]
        return found

    def count(self, full: int, quick: int) -> int:
        """Points, rays …"""
        return max(1, round(self.scale * (quick if self.quick else full)))

    def side(self, full: int, quick: int) -> int:
        """Pixels along an image's side, or points along a lattice's."""
        return max(8, round(self.scale * (quick if self.quick else full)))

    @cached_property
    def avatar(self) -> Avatar:
        """Raises `InputError` where it cannot be read."""
        return load_avatar(self.source)

    @cached_property
    def placed(self) -> Avatar:
        """The same with its networks on `device`. Raises `InputError`."""
        return self.avatar if self.device == "cpu" else load_avatar(self.source, self.device)

    @cached_property
    def subject(self) -> Subject:
        """Who the packaged avatar was fitted to."""
        return load_subject()

    def signals(self, frame: int = 0) -> Signals:
        """A frame of the motion of a person who stands at first; the root rests."""
        place, step = divmod(frame, FRAMES_BETWEEN)
        here, there = (Signals.rest().replace(body_pose=named_pose(WAY[(place + k) % len(WAY)])) for k in (0, 1))
        return interpolate(here, there, step / FRAMES_BETWEEN)

    @cached_property
    def standing(self) -> PosedPerson:
        """The avatar's person in the first frame."""
        return pose_person(self.avatar.person, self.signals(), Counters(), None)

    def camera(self, size: int, azimuth: float = 20.0) -> Camera:
        """Of the whole person, from the front."""
        return Camera.orbit(azimuth, 5, 2.6, 40, (0, -0.05, 0), size, size)
