"""Memory that a frame has freed stays with the program for the next one.

The C library gives large arrays back to the system at once and gets fresh pages for the next: a frame's arrays are the
same ones again, and faulting their pages in takes a tenth to a fifth of shading.
"""

from __future__ import annotations

import ctypes

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt(3)."""
LARGE, LARGEST_ONCE = 1 << 30, 1 << 25
"""Bytes: arrays up to so many come from the heap, and so many may lie free at its end; what glibc took before 2.35."""


def keep_pages() -> bool:
    """Set the C library so; False where it cannot be set."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):  # musl, macOS; Windows
        return False
    from_heap = mallopt(MMAP_THRESHOLD, LARGE) or mallopt(MMAP_THRESHOLD, LARGEST_ONCE)
    return bool(mallopt(TRIM_THRESHOLD, LARGE) and from_heap)
