"""What a picture cost: times, counters, notes and memory of its frame, as plain values."""

from __future__ import annotations

from dataclasses import dataclass

from avatarrex.frame import DeferredFrame
from avatarrex.templates.parts import PARTS
from avatarrex.volume.memory import Memory, memory_of


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
    unseen: frozenset[str]
    """Parts that are drawn, but were not built: off screen, or occluded by the body."""
    lags: bool
    """Whether what a drag hardly moved was kept from the picture before."""
    memory: Memory
    """Of the volume."""

    @classmethod
    def of(cls, frame: DeferredFrame, level: str) -> Work:
        """One frame's, rendered at `level`."""
        hidden, lags = frame.settings.hidden, frame.volume.changed is not None
        unseen = frozenset(PARTS) - hidden - frozenset(frame.volume.parts)
        memory = memory_of(frame.volume.sdf)
        return cls(frame.ms, frame.counters, frame.notes, frame.device, level, hidden, unseen, lags, memory)
