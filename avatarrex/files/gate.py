"""The gate for every file: what may be read, judged before memory is taken, and writing that leaves a whole file or none.

Read is a regular file of at most so many bytes: no pipe, no device, no socket. What a file contains is judged by its kind: text
here, JSON in `json_text.py`, zips in `zips.py`, arrays in `arrays.py`. Every refusal is one `InputError` that states the limit and
what was found. Nothing here needs torch, so that a wrong file or option is refused before torch is loaded.
"""

from __future__ import annotations

import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from avatarrex.errors import CannotWrite, InputError

TEXT_BYTES = 2**29
"""Bytes of the largest text file that is read: ten hours of BVH at 30 frames a second."""
LONGEST_LINE = 2**20
"""Letters of the longest line: fifty times what a frame of a hundred joints takes."""
UNFINISHED = ".unfinished-"
"""How the name of a file begins that is not written to its end."""


def what_is(path: str | Path) -> str:
    """`a file`, `a folder`, `nothing there`, `no plain file`, or the system's words, e.g. `Permission denied`."""
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return "nothing there"
    except (OSError, ValueError) as error:
        return getattr(error, "strerror", None) or str(error)
    return "a file" if stat.S_ISREG(mode) else "a folder" if stat.S_ISDIR(mode) else "no plain file"


def is_begun(folder: str | Path) -> bool:
    """Whether a folder holds anything: what a killed process had not finished, under a name with a dot, does not count."""
    return what_is(folder) == "a folder" and any(not name.startswith(".") for name in os.listdir(folder))


def check_file(path: str | Path, expected: str, largest: int, field: str = "") -> None:
    """Raise `InputError` unless `path` is a regular file of at most `largest` bytes; `expected` says what it should be."""
    found = what_is(path)
    if found != "a file":
        raise InputError(path, field, expected, found)
    check_bytes(os.stat(path).st_size, path, field, expected, largest)


def check_bytes(size: int, source: object, field: str, expected: str, largest: int) -> None:
    """Raise `InputError` where `size` bytes are more than `largest`."""
    if size > largest:
        raise InputError(source, field, f"{expected} of at most {_bytes(largest)}", _bytes(size))


def read_bytes(path: str | Path, expected: str, largest: int = TEXT_BYTES, field: str = "") -> bytes:
    """The content of a file. Raises `InputError`."""
    check_file(path, expected, largest, field)
    try:
        return Path(path).read_bytes()
    except (OSError, MemoryError) as error:
        raise InputError(path, field, expected, getattr(error, "strerror", None) or "too little memory") from None


def read_head(path: str | Path, expected: str, count: int) -> bytes:
    """The first bytes of a file of any size. Raises `InputError`."""
    check_file(path, expected, sys.maxsize)
    try:
        with open(path, "rb") as file:
            return file.read(count)
    except OSError as error:
        raise InputError(path, "", expected, error.strerror or error) from None


def read_text(path: str | Path, expected: str, errors: str = "strict", largest: int = TEXT_BYTES) -> str:
    """A UTF-8 text file, with or without a byte order mark. Raises `InputError`: `expected` says what it should be."""
    return decode(read_bytes(path, expected, largest), path, expected, errors)


def decode(content: bytes, source: object, expected: str, errors: str = "strict") -> str:
    """Bytes in UTF-8 as text with `\\n` at its line ends. Raises `InputError`."""
    try:
        return content.decode("utf-8-sig", errors).replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputError(source, f"byte {error.start}", f"{expected} in UTF-8", "another encoding") from None


def read_lines(path: str | Path, expected: str, errors: str = "strict") -> Iterator[str]:
    """The lines of a text file one after the other, without their ends: no more than one is in memory. Raises `InputError`."""
    check_file(path, expected, TEXT_BYTES)
    number = 1
    try:
        with open(path, encoding="utf-8-sig", errors=errors) as file:
            while line := file.readline(LONGEST_LINE):
                if len(line) == LONGEST_LINE:
                    raise InputError(
                        path, f"line {number}", f"lines of less than {LONGEST_LINE:,} letters", "a longer one"
                    )
                yield line.removesuffix("\n")
                number += 1
    except OSError as error:
        raise InputError(path, "", expected, error.strerror or error) from None
    except UnicodeDecodeError:
        raise InputError(path, f"line {number}", f"{expected} in UTF-8", "another encoding") from None


def _bytes(size: int) -> str:
    """`512 MiB`; below one, `300 kB`."""
    return f"{size >> 20} MiB" if size >= 1 << 20 else f"{max(size // 1000, 1)} kB"


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
        takes_none = isinstance(error, FileNotFoundError)  # the folder is there: /proc
        found = "one that takes no files" if takes_none else error.strerror or str(error)
        raise CannotWrite(path, "", f"a folder at {folder} that can be written", found) from None


@contextmanager
def written(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name once the block ends well, and vanishes otherwise.

    Raises `InputError` where the folder cannot be made or written.
    """
    path = Path(path)
    check_writable(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=UNFINISHED, suffix=path.suffix)
    except OSError as error:
        raise CannotWrite(path, "", "a file that can be written", error.strerror or error) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise CannotWrite(path, "", "a file that can be written", error.strerror or error) from None
    finally:
        temporary.unlink(missing_ok=True)


def remove_unfinished(folder: str | Path, below: bool = True) -> None:
    """Remove files that a killed process did not write to their ends, from a folder that nobody else writes to; also `below` it."""
    for path in Path(folder).glob(f"{'**/' if below else ''}{UNFINISHED}*"):
        if path.is_file():
            path.unlink(missing_ok=True)


@contextmanager
def written_folder(path: str | Path) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its name once the block ends well, and vanishes with all in it otherwise.

    Raises `InputError` where something lies at `path`, but for an empty folder, and where the folder cannot be made.
    """
    path = Path(path)
    found = what_is(path)
    if found != "nothing there" and (found != "a folder" or os.listdir(path)):
        raise InputError(
            path, "", "a name that is free, or an empty folder", f"{found} with files" if found == "a folder" else found
        )
    check_writable(path / "file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=path.parent, prefix="."))
    except OSError as error:
        raise CannotWrite(path, "", "a folder that can be written", error.strerror or error) from None
    try:
        yield temporary
        os.chmod(temporary, 0o755)
        if found == "a folder":
            path.rmdir()
        os.replace(temporary, path)
    except OSError as error:
        raise CannotWrite(path, "", "a folder that can be written", error.strerror or error) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: str | Path, text: str) -> None:
    """A text file, UTF-8."""
    with written(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
