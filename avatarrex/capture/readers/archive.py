"""The files of a capture: a folder, or a zip that is read without unpacking it.

Names are relative, with forward slashes. Nothing is ever written, and no name may leave the folder or zip.
"""

from __future__ import annotations

import os
import threading
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.gate import decode, read_bytes, what_is
from avatarrex.files.json_text import parse_json
from avatarrex.files.zips import open_zip, refusing, unpack

MEMBER_BYTES = 2**31
"""Bytes of one file: more is refused before it is read."""
PICTURE_BYTES = 2**29
"""Bytes of a picture's file: uncompressed at 8192×8192 it is half of that."""
TEXT_BYTES = 2**26
"""Bytes of a text: a line for each of half a million missing pictures."""
LONGEST_NAME, MOST_FOLDERS = 1000, 32
"""Letters of a name, and how many folders it may lead through."""


class Archive:
    """Files by name; safe for threads, for forked workers and for pickling (each process opens its own zip)."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        found = what_is(path)
        if found not in ("a file", "a folder"):
            raise InputError(path, "", "a capture: a folder or a .zip file", found)
        self._lock = threading.Lock()
        self._zip: tuple[int, zipfile.ZipFile] | None = None
        self._members: dict[str, set[str]] | None = None
        if found == "a file":
            if not zipfile.is_zipfile(self.path):
                raise InputError(path, "", "a capture: a folder or a .zip file", "another kind of file")
            self._members = self._list()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_lock": None, "_zip": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.Lock())

    def place(self, name: str) -> str:
        """What an error calls the file."""
        return f"{self.path}/{name}" if name else str(self.path)

    def entries(self, folder: str = "") -> frozenset[str]:
        """Names of files and folders in `folder`; none where there is no such folder."""
        if self._members is not None:
            return frozenset(self._members.get(folder, ()))
        try:
            return frozenset(os.listdir(self.path / folder))
        except OSError:
            return frozenset()

    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""
        if self._members is not None:
            folder, _, last = name.rpartition("/")
            return last in self._members.get(folder, ()) and name not in self._members
        return what_is(self.path / name) == "a file"

    def read(self, name: str, largest: int = MEMBER_BYTES) -> bytes:
        """The file's bytes. Raises `InputError` where it is missing, damaged, encrypted or too large."""
        place = self.place(name)
        if not self.exists(name):
            raise InputError(place, "", "the file to be there", "nothing")
        if self._members is None:
            return read_bytes(self.path / name, "a file", largest)
        with refusing(place, "", "a file that can be read"):
            return bytes(unpack(self._opened(), name, largest, place))

    def text(self, name: str) -> str:
        """The file as UTF-8."""
        return decode(self.read(name, TEXT_BYTES), self.place(name), "a text")

    def json(self, name: str) -> Any:
        """What a JSON file contains. Raises `InputError`."""
        return parse_json(self.text(name), self.place(name))

    def arrays(self, name: str, only: tuple[str, ...], largest: int = MEMBER_BYTES) -> dict[str, np.ndarray]:
        """Those of `only` that an `.npz` has, of at most `largest` bytes; nothing is unpickled. Raises `InputError`."""
        if not self.exists(name):
            raise InputError(self.place(name), "", "the file to be there", "nothing")
        source = self.path / name if self._members is None else self.read(name, largest)
        return read_arrays(source, only, largest, self.place(name))

    def _opened(self) -> zipfile.ZipFile:
        """This process's own handle: a fork shares the file position of its parent's."""
        with self._lock:
            if self._zip is None or self._zip[0] != os.getpid():
                self._zip = (os.getpid(), open_zip(self.path, "a complete .zip file"))
            return self._zip[1]

    def _list(self) -> dict[str, set[str]]:
        """Entries by folder."""
        folders: dict[str, set[str]] = {"": set()}
        for name in self._opened().namelist():
            parts = name.removesuffix("/").split("/")
            if not safe(name.removesuffix("/")):
                raise InputError(self.path, name[:60], "names inside the archive", "a name that leads out of it")
            if len(name) > LONGEST_NAME or len(parts) > MOST_FOLDERS:
                expected = f"names of at most {LONGEST_NAME} letters and {MOST_FOLDERS} folders"
                raise InputError(self.path, name[:60], expected, f"{len(name)} letters, {len(parts)} folders")
            for depth, part in enumerate(parts):
                folders.setdefault("/".join(parts[:depth]), set()).add(part)
            if name.endswith("/"):
                folders.setdefault("/".join(parts), set())
        return folders


@lru_cache(maxsize=4096)
def safe(name: str) -> bool:
    """Whether a name stays below the folder it is joined to: relative, no `..`, no drive, no backslash, no NUL."""
    parts = name.split("/")
    return bool(name) and not any(
        part in ("", ".", "..") or any(letter in part for letter in "\\:\0") for part in parts
    )
