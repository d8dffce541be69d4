"""Bytes of a volume, as the rays read it: body grid, bricks (numbers, and what the atlas has besides the grid), part boxes with
their contacts."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from avatarrex.volume.sdf_volume import SdfVolume


@dataclass(frozen=True)
class Memory:
    """Bytes."""

    body: int
    bricks: int
    parts: int

    @property
    def total(self) -> int:
        """Bytes of all three."""
        return self.body + self.bricks + self.parts


def memory_of(volume: SdfVolume) -> Memory:
    """What `volume` holds."""
    bricks = volume.body.bricks
    return Memory(
        body=_bytes(volume.body.sdf),
        bricks=_bytes(bricks.number) + _bytes(bricks.atlas) - _bytes(volume.body.sdf) if bricks else 0,
        parts=sum(_bytes(part.field) + (_bytes(part.contact.field) if part.contact else 0) for part in volume.parts),
    )


def _bytes(tensor: Tensor) -> int:
    return tensor.numel() * tensor.element_size()
