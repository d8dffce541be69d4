"""Arrays of `.npz` files: judged by the headers of their members, read without unpickling."""

from __future__ import annotations

import io
import math
import sys
import tokenize
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from avatarrex.errors import InputError
from avatarrex.files.gate import check_bytes, read_bytes
from avatarrex.files.zips import check_directory, open_member, open_zip, refusing, unpack

UNPACKED_BYTES = 2**31
"""Bytes that the arrays of one file may unpack to: a few MB of zip can claim any number."""
HEADER = 2**16
"""Bytes at the start of a member in which its header ends."""
LONGEST_SIDE = 2**48
PLAIN = "a plain array (no pickled objects)"
_BROKEN_HEADER = (ValueError, KeyError, TypeError, SyntaxError, RecursionError, MemoryError, tokenize.TokenError)
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_arrays(
    source: str | Path | bytes, only: Iterable[str] | None = None, largest: int = UNPACKED_BYTES, place: str = ""
) -> dict[str, np.ndarray]:
    """Every array of an `.npz` file (a path, or its bytes, called `place` in errors), or those of `only` that it has.

    Raises `InputError` naming file and array where it is missing or broken, or where the arrays take more than `largest` bytes.
    """
    place = place or str(source)
    arrays: dict[str, np.ndarray] = {}
    with refusing(place, "", "a complete .npz file"), _opened(source, place) as archive:
        members = {name.removesuffix(".npy"): name for name in archive.namelist()}
        total = 0
        for name in members if only is None else [name for name in only if name in members]:
            with refusing(place, name, "a complete .npz file"):
                info = archive.getinfo(members[name])
                total += info.file_size
                check_bytes(total, place, name, "arrays", largest)
                shape, fortran, dtype, start = _header(archive, info, place, name)
                if start + math.prod(shape) * dtype.itemsize > info.file_size:
                    raise InputError(place, name, f"{PLAIN} of shape {shape}", f"{info.file_size - start} bytes")
                content = unpack(archive, info.filename, largest, place, name)
                arrays[name] = _array(content, shape, fortran, dtype, start)
                check_letters(arrays[name])
    return arrays


def read_array(path: str | Path, largest: int = UNPACKED_BYTES) -> np.ndarray:
    """The array of an `.npy` file. Raises `InputError`."""
    content = read_bytes(path, "an array file", largest)
    shape, fortran, dtype, start = _described(io.BytesIO(content[:HEADER]), str(path), "")
    if start + math.prod(shape) * dtype.itemsize > len(content):
        raise InputError(path, "", f"{PLAIN} of shape {shape}", f"{len(content) - start} bytes")
    array = _array(bytearray(content), shape, fortran, dtype, start)
    with refusing(path, "", PLAIN):
        check_letters(array)
    return array


def check_letters(array: np.ndarray) -> None:
    """Raise `ValueError` for texts with a letter that Unicode does not have: Python fails on those."""
    if array.dtype.kind != "U" or not array.size:
        return
    letters = np.ascontiguousarray(array).reshape(-1).view(np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
    if letters.max(initial=0) > sys.maxunicode:
        raise ValueError("a letter that Unicode does not have")


def _opened(source: str | Path | bytes, place: str) -> zipfile.ZipFile:
    if not isinstance(source, bytes):
        return open_zip(source, "a complete .npz file")
    check_directory(io.BytesIO(source), place)
    return zipfile.ZipFile(io.BytesIO(source))


def _header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, place: str, name: str
) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Shape, whether columns run first, type, and where the values start, of a member. Raises `InputError`."""
    with open_member(archive, info, place, name) as member:
        return _described(io.BytesIO(member.read(HEADER)), place, name)


def _described(head: io.BytesIO, place: str, name: str) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """The same of the bytes at an array's start."""
    if not head.getvalue().startswith(npy.MAGIC_PREFIX):
        raise InputError(place, name, PLAIN, "other bytes")
    try:
        shape, fortran, dtype = _HEADERS[npy.read_magic(head)](head)
        if any(type(length) is not int for length in shape):  # NumPy takes True for one
            raise ValueError("a shape of other numbers than sides")
        if any(length > LONGEST_SIDE for length in shape):
            raise ValueError("a side of more numbers than any file has")
    except _BROKEN_HEADER as error:
        raise InputError(place, name, PLAIN, error) from None
    if dtype.hasobject or dtype.names or not dtype.itemsize or any(length < 0 for length in shape):
        raise InputError(place, name, PLAIN, f"shape {shape} of {dtype}")
    return shape, fortran, dtype, head.tell()


def _array(content: bytearray, shape: tuple[int, ...], fortran: bool, dtype: np.dtype, start: int) -> np.ndarray:
    count = math.prod(shape)
    flat = np.frombuffer(content, dtype, count, start) if count else np.zeros(0, dtype)
    return flat.reshape(shape, order="F" if fortran else "C")
