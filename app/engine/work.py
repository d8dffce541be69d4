"""What a picture cost: times, counters and notes of one frame or of several strips."""

from __future__ import annotations

from dataclasses import dataclass, replace

from avatarrex.frame import DeferredFrame, Frame
from avatarrex.levels import LEVELS
from avatarrex.templates.parts import PARTS


@dataclass(frozen=True)
class Work:
    """Times, counters and notes of a picture."""

    ms: dict[str, float]
    """Milliseconds of each stage, and their `total`."""
    counters: dict[str, int]
    notes: tuple[str, ...]
    device: str
    """The torch device that the networks ran on."""
    level: str
    hidden: frozenset[str]
    """Parts that were not drawn with their own fields."""
    unseen: frozenset[str] = frozenset()
    """Parts that are drawn, but were not built: off screen, or occluded by the body."""
    lags: bool = False
    """Whether what a drag hardly moved was kept from the picture before."""
    rough: bool = False
    """Whether a drag may have coarser voxels than the level."""

    @classmethod
    def of(cls, frame: Frame, level: str) -> Work:
        """One frame's, rendered at `level`."""
        hidden, lags = frame.settings.hidden, isinstance(frame, DeferredFrame) and frame.volume.changed is not None
        rough = frame.settings.voxel > LEVELS[level].voxel
        unseen = frozenset(PARTS) - hidden - _built(frame)
        return cls(frame.ms, frame.counters, frame.notes, frame.device, level, hidden, unseen, lags, rough)

    def plus(self, frame: Frame) -> Work:
        """With another strip's."""
        ms = {name: value + frame.ms[name] for name, value in self.ms.items()}
        counters = {name: count + frame.counters[name] for name, count in self.counters.items()}
        unseen = self.unseen - _built(frame)
        return replace(self, ms=ms, counters=counters, notes=frame.notes, unseen=unseen)


def _built(frame: Frame) -> frozenset[str]:
    """Parts that the frame has; a surface has all of them."""
    return frozenset(frame.volume.parts if isinstance(frame, DeferredFrame) else PARTS)
