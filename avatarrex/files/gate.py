"""Files as a whole: text and JSON read with one clear error, and writing that leaves a whole file or none.

Nothing here needs torch, so that a wrong file or option is refused before torch is loaded.
"""

from __future__ import annotations

import json
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from avatarrex.errors import InputError

LARGEST = 2**29
"""Bytes of the largest text file that is read: ten hours of BVH at 30 frames a second."""


def what_is(path: str | Path) -> str:
    """`a file`, `a folder`, `nothing there`, `no plain file`, or the system's words, e.g. `Permission denied`."""
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return "nothing there"
    except (OSError, ValueError) as error:
        return getattr(error, "strerror", None) or str(error)
    return "a file" if stat.S_ISREG(mode) else "a folder" if stat.S_ISDIR(mode) else "no plain file"


def read_text(path: str | Path, expected: str, errors: str = "strict") -> str:
    """A UTF-8 text file, with or without a byte order mark. Raises `InputError`: `expected` says what it should be."""
    found = what_is(path)
    if found != "a file":
        raise InputError(path, "", expected, found)
    try:
        size = os.path.getsize(path)
        if size > LARGEST:
            raise InputError(path, "", f"{expected} of at most {LARGEST >> 20} MiB", f"{size >> 20} MiB")
        return Path(path).read_text(encoding="utf-8-sig", errors=errors)
    except OSError as error:
        raise InputError(path, "", expected, error.strerror or error) from None
    except UnicodeDecodeError as error:
        raise InputError(path, f"byte {error.start}", f"{expected} in UTF-8", "another encoding") from None


def read_json(path: str | Path, expected: str = "a JSON file") -> Any:
    """What a JSON file holds. Raises `InputError`."""
    return parse_json(read_text(path, expected), path, "", expected)


def parse_json(text: str, source: str | Path, field: str = "", expected: str = "JSON") -> Any:
    """What a JSON text holds. Raises `InputError`."""
    try:
        return json.loads(text)
    except ValueError as error:
        raise InputError(source, field, expected, error) from None
    except RecursionError:
        raise InputError(source, field, expected, "brackets nested too deeply") from None


def check_writable(path: str | Path) -> None:
    """Raise `InputError` where `path` could not be written as a file; nothing stays behind."""
    path = Path(path)
    found = what_is(path)
    if found not in ("a file", "nothing there"):
        raise InputError(path, "", "a file to write", found)
    folder = path.parent
    while what_is(folder) == "nothing there" and folder != folder.parent:
        folder = folder.parent
    found = what_is(folder)
    if found != "a folder":
        raise InputError(path, "", f"a folder at {folder}", found)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(path, "", f"a folder at {folder} that can be written", error.strerror or error) from None


@contextmanager
def written(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name once the block ends well, and vanishes otherwise.

    Raises `InputError` where the folder cannot be made or written.
    """
    path = Path(path)
    check_writable(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=path.suffix)
    except OSError as error:
        raise InputError(path, "", "a file that can be written", error.strerror or error) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(path, "", "a file that can be written", error.strerror or error) from None
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """A text file, UTF-8."""
    with written(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
