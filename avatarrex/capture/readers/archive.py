"""The files of a capture: a folder, or a zip that is read without unpacking it.

Names are relative, with forward slashes. Nothing is ever written, and no name may leave the folder or zip.
"""

from __future__ import annotations

import io
import os
import threading
import zipfile
import zlib
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from avatarrex.errors import InputError

LARGEST = 4 << 30
"""Bytes of one file: more is refused before it is unpacked."""


class Archive:
    """Files by name; safe for threads, for forked workers and for pickling (each process opens its own zip)."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise InputError(path, "", "a capture: a folder or a .zip file", "nothing there")
        self._lock = threading.Lock()
        self._zip: tuple[int, zipfile.ZipFile] | None = None
        self._members: dict[str, set[str]] | None = None
        if not self.path.is_dir():
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
        return (self.path / name).is_file()

    def read(self, name: str) -> bytes:
        """The file's bytes. Raises `InputError` where it is missing, damaged or encrypted."""
        if not self.exists(name):
            raise InputError(self.place(name), "", "the file to be there", "nothing")
        try:
            if self._members is None:
                size = (self.path / name).stat().st_size
                self._limit(name, size)
                return (self.path / name).read_bytes()
            opened = self._opened()
            self._limit(name, opened.getinfo(name).file_size)
            return opened.read(name)
        except (OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, KeyError) as error:
            raise InputError(self.place(name), "", "a file that can be read", error) from None

    def text(self, name: str) -> str:
        """The file as UTF-8."""
        try:
            return self.read(name).decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise InputError(self.place(name), "", "UTF-8 text", error) from None

    def arrays(self, name: str, only: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
        """The arrays of an `.npz`, or those of `only` that it has; nothing is unpickled. Raises `InputError`."""
        data, key = self.read(name), ""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                if not isinstance(archive, np.lib.npyio.NpzFile):
                    raise InputError(self.place(name), "", "an .npz file", "a single array")
                found = {}
                for key in archive.files if only is None else [key for key in only if key in archive.files]:
                    found[key] = archive[key]
                return found
        except InputError:
            raise
        except (OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, MemoryError) as error:
            raise InputError(self.place(name), key, "a complete .npz file", error) from None
        except ValueError as error:
            raise InputError(self.place(name), key, "a plain array (no pickled objects)", error) from None

    def keys(self, name: str) -> tuple[str, ...]:
        """Names of the arrays of an `.npz`."""
        try:
            with zipfile.ZipFile(io.BytesIO(self.read(name))) as archive:
                return tuple(entry.removesuffix(".npy") for entry in archive.namelist())
        except zipfile.BadZipFile as error:
            raise InputError(self.place(name), "", "a complete .npz file", error) from None

    def _limit(self, name: str, size: int) -> None:
        if size > LARGEST:
            raise InputError(self.place(name), "", f"at most {LARGEST >> 30} GiB", f"{size / (1 << 30):.1f} GiB")

    def _opened(self) -> zipfile.ZipFile:
        """This process's own handle: a fork shares the file position of its parent's."""
        with self._lock:
            if self._zip is None or self._zip[0] != os.getpid():
                self._zip = (os.getpid(), zipfile.ZipFile(self.path))
            return self._zip[1]

    def _list(self) -> dict[str, set[str]]:
        """Entries by folder."""
        try:
            names = self._opened().namelist()
        except (OSError, zipfile.BadZipFile) as error:
            raise InputError(self.path, "", "a complete .zip file", error) from None
        folders: dict[str, set[str]] = {"": set()}
        for name in names:
            if not safe(name.rstrip("/")):
                raise InputError(self.path, name, "names inside the archive", "a name that leads out of it")
            parts = PurePosixPath(name).parts
            for depth, part in enumerate(parts):
                folders.setdefault("/".join(parts[:depth]), set()).add(part)
            if name.endswith("/"):
                folders.setdefault("/".join(parts), set())
        return folders


@lru_cache(maxsize=4096)
def safe(name: str) -> bool:
    """Whether a name stays below the folder it is joined to: relative, no `..`, no drive, no backslash."""
    parts = name.split("/")
    return bool(name) and not any(part in ("", ".", "..") or "\\" in part or ":" in part for part in parts)
