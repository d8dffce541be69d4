"""What a picture cost: times, counters, notes and memory of its frame, as plain values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from avatarrex.frame import DeferredFrame, Frame
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
    def of(cls, frames: Sequence[DeferredFrame], level: str) -> Work:
        """That of a picture's frames, one a figure, rendered at `level`: of all together."""
        hidden = frozenset.intersection(*(frame.settings.hidden for frame in frames))
        unseen = (
            frozenset.intersection(*(frozenset(PARTS) - frozenset(frame.volume.parts) for frame in frames)) - hidden
        )
        lags = any(frame.volume.changed is not None for frame in frames)
        memory = _sum([vars(memory_of(frame.volume.sdf)) for frame in frames])
        ms, counters = summed(frames).values()
        return cls(ms, counters, frames[0].notes, frames[0].device, level, hidden, unseen, lags, Memory(**memory))


def summed(frames: Sequence[Frame]) -> dict[str, dict[str, Any]]:
    """`ms` and `counters` of all figures of a picture together."""
    return {name: _sum([getattr(frame, name) for frame in frames]) for name in ("ms", "counters")}


def _sum(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of numbers by name."""
    return {name: sum(row[name] for row in rows) for name in rows[0]}
