"""Memory that a program has freed: what becomes of it is a matter of what it does.

The C library gives large arrays back to the system at once and gets fresh pages for the next. Whoever renders frame after frame keeps
them (`keep_pages`): a frame's arrays are the same ones again, and faulting their pages in takes a tenth to a fifth of shading. A window
lives for hours and avatars, pictures and sizes come and go: it gives them back (`give_pages`), and what small ones have left in between
when it rests (`give_back`).
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from typing import Any

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt(3)."""
LARGE, LARGEST_ONCE = 1 << 30, 1 << 25
"""Bytes: arrays up to so many come from the heap, and so many may lie free at its end; what glibc took before 2.35."""
PASSING, SPARE = 1 << 20, 1 << 24
"""Bytes of arrays that a window gives back at once, more than a posed surface's largest has; and that may lie free at the heap's end."""

STILL, EVERY = 1.0, 10.0
"""Seconds that a window has been at rest before it gives back, and between two times."""


def keep_pages() -> bool:
    """Freed memory stays with the program; False where the C library cannot be set so."""
    mallopt = _function("mallopt")
    if mallopt is None:
        return False
    from_heap = mallopt(MMAP_THRESHOLD, LARGE) or mallopt(MMAP_THRESHOLD, LARGEST_ONCE)
    return bool(mallopt(TRIM_THRESHOLD, LARGE) and from_heap)


def give_pages() -> bool:
    """Large arrays go back to the system once they are freed; False where the C library cannot be set so."""
    mallopt = _function("mallopt")
    return bool(mallopt and mallopt(MMAP_THRESHOLD, PASSING) and mallopt(TRIM_THRESHOLD, SPARE))


def give_back() -> bool:
    """Give back now what lies free, some milliseconds' work; False where there was nothing, or the C library cannot."""
    trim = _function("malloc_trim")
    return bool(trim and trim(ctypes.c_size_t(0)))


class Resting:
    """Gives back once after whatever moved, while nothing does."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, give: Callable[[], object] = give_back) -> None:
        self._clock, self._give = clock, give
        self._moved_at = self._gave_at = clock()
        self._moved = False

    def tend(self, moving: bool) -> None:
        """Once a frame: whether anything moves, is read or made."""
        now = self._clock()
        if moving:
            self._moved, self._moved_at = True, now
        elif self._moved and now - self._moved_at >= STILL and now - self._gave_at >= EVERY:
            self._moved, self._gave_at = False, now
            self._give()


def _function(name: str) -> Any:
    """Of the C library; None where it has none of that name."""
    try:
        return getattr(ctypes.CDLL(None), name)
    except (OSError, AttributeError, TypeError):  # musl, macOS; Windows
        return None
