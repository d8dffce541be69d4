"""A folder's entries and the places a file dialog begins at. No window library."""

from __future__ import annotations

import os
import string
import sys
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is

MOST = 5000
"""Entries of a folder that are listed."""


@dataclass(frozen=True)
class Entry:
    """A file or a folder."""

    name: str
    path: str
    is_folder: bool
    size: int = 0
    """Bytes; of a folder 0."""
    changed: float = 0.0
    """Seconds since 1970."""

    @property
    def size_words(self) -> str:
        """`3.4 MB`; nothing for a folder."""
        return "" if self.is_folder else size_words(self.size)

    @property
    def changed_words(self) -> str:
        """`2026-11-24 09:30`."""
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(self.changed))


def listed(folder: str, suffixes: Collection[str] = ()) -> tuple[Entry, ...]:
    """Folders, then files with one of these suffixes (all where none is given), by name, hidden ones left out. Raises `InputError`."""
    try:
        with os.scandir(folder) as entries:
            found = [_entry(entry) for entry in entries if not entry.name.startswith(".")]
    except (OSError, ValueError) as error:
        raise InputError(folder, "", "a folder that can be read", getattr(error, "strerror", None) or error) from None
    kept = (entry for entry in found if entry.is_folder or not suffixes or Path(entry.name).suffix.lower() in suffixes)
    return tuple(sorted(kept, key=lambda entry: (not entry.is_folder, entry.name.lower())))[:MOST]


def places() -> dict[str, str]:
    """Folders to begin at, by what a person calls them; those that are there."""
    home = Path.home()
    named = {"Working folder": Path.cwd(), "Home": home}
    named.update({name: home / name for name in ("Desktop", "Documents", "Downloads")})
    if sys.platform == "win32":
        named.update({f"{letter}:": Path(f"{letter}:/") for letter in string.ascii_uppercase})
    else:
        named["Computer"] = Path("/")
    return {name: str(path) for name, path in named.items() if what_is(path) == "a folder"}


def size_words(size: int) -> str:
    """Bytes in thousands, as file managers write them: `512 B`, `3.4 MB`."""
    if size < 1000:
        return f"{size} B"
    value, unit = size / 1000, 0
    while value >= 999.5 and unit < 3:
        value, unit = value / 1000, unit + 1
    return f"{value:.1f} {'kMGT'[unit]}B" if value < 9.95 else f"{value:.0f} {'kMGT'[unit]}B"


def _entry(entry: os.DirEntry[str]) -> Entry:
    """What can be known of it: a link to nothing has no size."""
    try:
        about = entry.stat()
        return Entry(entry.name, entry.path, entry.is_dir(), about.st_size, about.st_mtime)
    except OSError:
        return Entry(entry.name, entry.path, False)
