"""What tells whether a file, or a file of a folder, has changed since it was read, without reading it."""

from __future__ import annotations

from pathlib import Path

Stamp = tuple[tuple[Path, int, int], ...]
"""Files, when they were changed last (ns) and their bytes."""


def stamp(path: Path) -> Stamp:
    """Of a file, or of the files of a folder; empty where nothing is there."""
    try:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        return tuple((file, found.st_mtime_ns, found.st_size) for file in files for found in [file.stat()])
    except (OSError, ValueError):  # ValueError: a name that can be none of a file
        return ()
