"""A user's own poses, hands and expressions: one JSON file each in a folder that can be shared.

    FOLDER/pose/NAME.json    {"format": 1, "kind": "pose", "name": …, "signals": {…}}

The folder is `AVATARREX_LIBRARY`, or else the system's place for a user's data (`library_folder`). What an entry contains is what
`PARTS` lists for its kind; a hand is stored as a left one. Files that are refused are listed with their reason and change nothing.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import read_json, write_json
from avatarrex.files.user_folder import user_folder
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import mirror

FORMAT = 1
ENTRY_BYTES = 2**16
"""Bytes of an entry's file: three times those of all numbers of a signal."""
MOST = 2000
"""Entries of a kind that are listed."""
LONGEST = 60
"""Letters of a name."""
Stamp = frozenset[tuple[str, int, int]]
"""Name, size and time of change of each file of a folder."""
PARTS = {
    "pose": ("body_pose", "left_hand_pose", "right_hand_pose"),
    "hand": ("left_hand_pose",),
    "expression": ("expression", "jaw_pose", "eye_pose"),
}
"""What an entry of each kind sets."""


@dataclass(frozen=True)
class Entry:
    """A saved pose, hand or expression; fields of `signals` that its kind does not set are at rest."""

    kind: str
    name: str
    signals: Signals

    def to_json(self) -> dict[str, Any]:
        """The file's content."""
        values = {part: getattr(self.signals, part).tolist() for part in PARTS[self.kind]}
        return {"format": FORMAT, "kind": self.kind, "name": self.name, "signals": values}

    @classmethod
    def from_json(cls, data: Any, source: str) -> Entry:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict) or not (isinstance(data.get("kind"), str) and data["kind"] in PARTS):
            raise InputError(
                source, "kind", " or ".join(PARTS), data.get("kind") if isinstance(data, dict) else type(data).__name__
            )
        if data.get("format") != FORMAT:
            raise InputError(source, "format", f"{FORMAT}", data.get("format"))
        if unknown := sorted(set(data) - {"format", "kind", "name", "signals"}):
            raise InputError(source, unknown[0], "one of format, kind, name, signals", "an unknown field")
        kind, values = data["kind"], data.get("signals")
        if not isinstance(values, dict) or set(values) != set(PARTS[kind]):
            raise InputError(
                source,
                "signals",
                "an object of " + ", ".join(PARTS[kind]),
                sorted(values) if isinstance(values, dict) else type(values).__name__,
            )
        return cls(kind, checked_name(data.get("name"), source), Signals.from_json(values, source))


class UserLibrary:
    """The entries in a folder. Reads when told to; every change is on the disk before it is in `entries`."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or library_folder()
        self.entries: dict[str, dict[str, Entry]] = {kind: {} for kind in PARTS}
        """By kind and name."""
        self.refused: list[str] = []
        """A line for each file that is none."""
        self._stamp: tuple[Stamp, ...] = ()

    def follow(self) -> None:
        """Read the folder again where its files have changed since the last time."""
        stamp = tuple(_stamp(self.folder / kind) for kind in PARTS)
        if stamp != self._stamp:
            self._stamp = stamp
            self.read()

    def read(self) -> None:
        """Read the folder again; what is no entry becomes a line of `refused`."""
        self.refused = []
        for kind in PARTS:
            found: dict[str, Entry] = {}
            folder = self.folder / kind
            for path in sorted(folder.glob("*.json"))[:MOST] if what_is(folder) == "a folder" else ():
                try:
                    entry = Entry.from_json(read_json(path, "an entry of a library", ENTRY_BYTES), str(path))
                    if entry.kind != kind:
                        raise InputError(path, "kind", kind, entry.kind)
                    if entry.name != path.stem:
                        raise InputError(path, "name", path.stem, entry.name)
                    found[entry.name] = entry
                except InputError as error:
                    self.refused.append(str(error))
            self.entries[kind] = found

    def save(self, entry: Entry, overwrite: bool = False) -> None:
        """Write an entry. Raises `InputError` for a name that is taken, unless it may be overwritten."""
        checked_name(entry.name, "library")
        path = self.path(entry.kind, entry.name)
        if not overwrite and what_is(path) != "nothing there":
            raise InputError("library", "name", "one that is not taken", entry.name)
        write_json(path, entry.to_json())
        self.entries[entry.kind] = dict(sorted({**self.entries[entry.kind], entry.name: entry}.items()))

    def rename(self, kind: str, old: str, new: str) -> None:
        """Give an entry another name. Raises `InputError` for one that is taken."""
        if new != old:
            self.save(Entry(kind, new, self.entries[kind][old].signals))
            self.delete(kind, old)

    def delete(self, kind: str, name: str) -> None:
        """Remove an entry and its file. Raises `InputError` where the file cannot be removed."""
        path = self.path(kind, name)
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise InputError(path, "", "a file that can be removed", error.strerror or error) from None
        self.entries[kind].pop(name, None)

    def path(self, kind: str, name: str) -> Path:
        """An entry's file."""
        return self.folder / kind / f"{name}.json"


def taken(signals: Signals, kind: str, name: str, side: str = "left") -> Entry:
    """The present `kind` of `signals` under a name; of a right hand its mirror image."""
    if kind == "hand" and side == "right":
        signals = mirror(signals)
    return Entry(kind, name, Signals.rest().replace(**{part: getattr(signals, part) for part in PARTS[kind]}))


def parts_of(entry: Entry, mirrored: bool = False, sides: tuple[str, ...] = ("left",)) -> Mapping[str, np.ndarray]:
    """The fields of the signals that an entry sets: a pose or an expression, `mirrored` or not, a hand on some `sides`."""
    flipped = mirror(entry.signals)
    if entry.kind == "hand":
        hands = {"left": entry.signals.left_hand_pose, "right": flipped.right_hand_pose}
        return {f"{side}_hand_pose": hands[side] for side in sides}
    source = flipped if mirrored else entry.signals
    return {part: getattr(source, part) for part in PARTS[entry.kind]}


def checked_name(name: object, source: str) -> str:
    """`name`, one that every system's files can have. Raises `InputError`."""
    expected = f"1 to {LONGEST} letters, digits, spaces, - or _"
    if not isinstance(name, str) or not 0 < len(name) <= LONGEST or name != name.strip():
        raise InputError(source, "name", expected, repr(name)[:LONGEST])
    if not all(letter.isalnum() or letter in " -_" for letter in name) or name.split(".")[0].upper() in _RESERVED:
        raise InputError(source, "name", expected, repr(name)[:LONGEST])
    return name


def _stamp(folder: Path) -> Stamp:
    """What tells a folder's content from a changed one; a folder that cannot be read is empty."""
    try:
        with os.scandir(folder) as files:
            return frozenset((file.name, about.st_size, about.st_mtime_ns) for file in files if (about := file.stat()))
    except OSError:
        return frozenset()


def library_folder() -> Path:
    """`AVATARREX_LIBRARY`, or `avatarrex-studio/library` where the system keeps a user's data."""
    if folder := os.environ.get("AVATARREX_LIBRARY"):
        return Path(folder)
    return user_folder("XDG_DATA_HOME", (".local", "share"), "Application Support") / "avatarrex-studio" / "library"


def cache_folder() -> Path:
    """`avatarrex-studio` where the system keeps what can be made again."""
    return user_folder("XDG_CACHE_HOME", (".cache",), "Caches") / "avatarrex-studio"


def state_folder() -> Path:
    """`avatarrex-studio` where the system keeps what a program remembers between its runs."""
    return user_folder("XDG_STATE_HOME", (".local", "state"), "Application Support") / "avatarrex-studio"


_RESERVED = {"CON", "PRN", "AUX", "NUL", *(f"{port}{k}" for port in ("COM", "LPT") for k in range(1, 10))}
"""Names that no file of Windows can have."""
