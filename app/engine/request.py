"""Requests to the exact engine and its answers: plain values that cross from one process to another.

Letters: h w image rows and columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from avatarrex_studio.engine.work import Work
from avatarrex_studio.session.state import StudioState, Vector
from jaxtyping import Float32, UInt8

from avatarrex.surface.floor import FloorLight


class Seen(NamedTuple):
    """What is under a place of a picture."""

    point: Vector
    """World metres."""
    figure: int
    """Its number among all."""


@dataclass(frozen=True)
class Request:
    """One picture."""

    state: StudioState
    size: tuple[int, int]
    """Width and height."""
    dragged: bool = False
    """Whether the next one comes at once, so that this one may be rougher (`Engine.render`)."""
    path: str = ""
    """The PNG to write; empty: the picture comes back."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered picture."""

    image: UInt8[np.ndarray, "h w 4"]
    """Premultiplied sRGB-encoded colour and coverage, row 0 at the top."""
    depth: Float32[np.ndarray, "h w"]
    """Camera z, metres; 0 where the ray through the pixel's centre misses."""
    figure: UInt8[np.ndarray, "h w"]
    """Whose depth it is, by number."""
    work: Work
    floor: FloorLight | None = None
    """The light on the floor of a stage."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What became of a request. Without picture and error it was written, or cancelled."""

    request: Request
    picture: Picture | None = None
    error: str | None = None
    cancelled: bool = False


@runtime_checkable
class Exact(Protocol):
    """Who renders exact pictures while the caller goes on; no method waits."""

    @property
    def busy(self) -> bool:
        """Whether an answer is to come."""

    def request(self, request: Request) -> None:
        """Render this next. It takes the place of a picture that was not begun; files to write are all written."""

    def cancel(self) -> None:
        """Drop the picture that was not begun, and end the one under way at its next stage; files go on. Both are answered."""

    def poll(self) -> Answer | None:
        """The next answer, where one has come."""

    def close(self) -> None:
        """End; nothing is answered any more."""
