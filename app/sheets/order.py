"""What contact sheets are to be drawn, of whom and where to. Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.session.motion import Motion

SHEETS = ("body", "face", "hands", "motion", "close", "floaters")
"""In their order; `floaters` is a list, the others are pictures."""
COLUMNS, MOST = 8, 24
"""Frames of a motion in one band of its sheet, and unless others are named; and the most that a sheet has room for."""
TRUTHS = {"subject": "default", "loose": "loose"}
"""The packaged subject of each word that says who is drawn beside the avatar."""


@dataclass(frozen=True)
class SheetOrder:
    """A checked order."""

    avatar: str
    out: Path
    only: tuple[str, ...]
    """Of `SHEETS`, in their order; `motion` only where there is one, `close` only with a capture."""
    truth: str | None
    """The name of a packaged subject, or the path of a capture."""
    mesh: bool
    """Whether the fitted textured mesh is drawn, too, on pages of a capture's pictures."""
    other: str | None
    """A second avatar, of motions and close-ups."""
    motion: Motion | None
    frames: tuple[int, ...]
    samples: int
    levels: tuple[str, ...]
