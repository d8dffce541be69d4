"""Memory that a frame has freed stays with the program for the next one.

The C library gives large arrays back to the system at once and asks for fresh pages for the next: a frame's arrays are the
same ones again, and faulting their pages in takes a tenth to a fifth of shading.
"""

from __future__ import annotations

import ctypes

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt(3)."""
LARGE = 1 << 30
"""Bytes: arrays up to so many come from the heap, and so many may lie free at its end."""


def keep_pages() -> bool:
    """Ask the C library for it; False where it is another than glibc."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(MMAP_THRESHOLD, LARGE) and mallopt(TRIM_THRESHOLD, LARGE))
