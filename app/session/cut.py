"""The plane through the avatars in which the exact field is shown. Metres, world."""

from __future__ import annotations

from dataclasses import dataclass

from avatarrex_studio.session.timeline import check

from avatarrex.errors import InputError

AXES = {"z": "Front", "x": "Side", "y": "Top"}
"""Where a plane across each axis is seen from."""
FARTHEST = 100.0
"""Metres."""


@dataclass(frozen=True)
class Cut:
    """All points whose coordinate along `axis` is `offset`."""

    axis: str = "z"
    offset: float = 0.0

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise InputError("cut", "axis", " or ".join(AXES), self.axis)
        check("cut", "offset", self.offset, (-FARTHEST, FARTHEST))

    @property
    def row(self) -> int:
        """Of the axis among x, y, z."""
        return "xyz".index(self.axis)
