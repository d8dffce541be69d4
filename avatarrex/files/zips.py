"""Zip archives: their list of names and what a member unpacks to are judged before memory is taken.

A member may lie about its size: no more is unpacked than it announces. Methods other than deflate unpack without bounds in
Python's `zipfile`, and are refused.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedIOBase
from pathlib import Path

from avatarrex.errors import InputError
from avatarrex.files.gate import check_bytes, what_is

DIRECTORY = 2**26
"""Bytes of a zip's list of names: half a million pictures. Python takes about ten times as much for it."""
BLOCK_BYTES = 2**20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_TAIL = 22 + 2**16
"""Bytes at a zip's end in which its end record is looked for: the record and its longest comment."""
BROKEN = (
    OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, MemoryError, KeyError, ValueError, OverflowError,
    struct.error,
)  # fmt: skip
"""What reading a damaged archive may raise. RuntimeError: an encrypted one; KeyError: names that do not fit its entries."""


def open_zip(path: str | Path, expected: str) -> zipfile.ZipFile:
    """The zip at `path`, its list of names read. Raises `InputError`: `expected` says what it should be."""
    found = what_is(path)
    if found != "a file":
        raise InputError(path, "", expected, found)
    with refusing(path, "", expected):
        with open(path, "rb") as file:
            check_directory(file, path)
        return zipfile.ZipFile(path)


@contextmanager
def refusing(source: object, field: str, expected: str, errors: tuple[type[Exception], ...] = BROKEN) -> Iterator[None]:
    """What a damaged archive raises in the block, or another one of `errors`, becomes an `InputError`."""
    try:
        yield
    except InputError:
        raise
    except errors as error:
        raise InputError(source, field, expected, str(error).strip() or type(error).__name__) from None


def check_directory(file: BufferedIOBase, source: object) -> None:
    """Raise `InputError` where the list of names of the zip in `file` is larger than `DIRECTORY`."""
    size = file.seek(0, 2)
    file.seek(max(size - _TAIL, 0))
    tail = file.read(_TAIL)
    end = tail.rfind(b"PK\5\6")
    if end < 0 or end + 22 > len(tail):
        return  # no zip: whoever opens it says so
    length = struct.unpack_from("<I", tail, end + 12)[0]
    if tail[max(end - 20, 0) : end].startswith(
        b"PK\6\7"
    ):  # a 64-bit zip: its end record is named by, and before, this one
        file.seek(struct.unpack_from("<Q", tail, end - 12)[0])
        for record in (file.read(56), tail[max(end - 76, 0) : end - 20]):
            if record.startswith(b"PK\6\6") and len(record) == 56:
                length = max(length % 0xFFFFFFFF, struct.unpack_from("<Q", record, 40)[0])
    check_bytes(length, source, "", "a zip with a list of names", DIRECTORY)


def unpack(archive: zipfile.ZipFile, name: str, largest: int, source: object, field: str = "") -> bytearray:
    """A member's bytes. Raises `InputError` where it unpacks to more than `largest`, and what a damaged archive raises."""
    info = archive.getinfo(name)
    check_bytes(info.file_size, source, field, "a file", largest)
    content = bytearray()
    with open_member(archive, info, source, field) as member:
        while block := member.read(BLOCK_BYTES):
            content += block
    return content


@contextmanager
def open_member(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, source: object, field: str
) -> Iterator[zipfile.ZipExtFile]:
    """A member to be read in blocks. Raises `InputError` where it is packed in another way than deflate."""
    if info.flag_bits & 1:
        raise InputError(source, field, "a member without a password", "an encrypted one")
    if info.compress_type not in _METHODS:
        raise InputError(source, field, "a member that is stored or deflated", f"method {info.compress_type}")
    with archive.open(info) as member:
        yield member  # type: ignore[misc]
