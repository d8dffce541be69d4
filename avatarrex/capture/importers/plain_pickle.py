"""Dictionaries and lists of numbers and words that NumPy has pickled into an `.npy`: nothing else is unpickled.

What makes a plain NumPy array is admitted by name; every other name is refused with its own, and nothing of the file is called.
"""

from __future__ import annotations

import codecs
import io
import pickle
from typing import Any

import numpy as np
from numpy.lib import format as npy

from avatarrex.errors import InputError

LARGEST_BYTES = 2**28
"""Of such a file: half a million names of pictures."""
EXPECTED = "an .npy file of plain dictionaries, lists and arrays"


def _empty(kind: type, shape: object, code: object) -> np.ndarray:
    """An array that its state then fills, whatever shape the file announces."""
    if kind is not np.ndarray:
        raise pickle.UnpicklingError(f"an array of kind {kind!r}")
    return np.ndarray.__new__(np.ndarray, (0,), np.int8)


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """Bytes as Python 2 wrote them."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"bytes in {encoding!r}")
    return codecs.encode(text, "latin1")


_MODULES = ("numpy.core.multiarray", "numpy._core.multiarray")
ADMITTED = {
    **{(module, "_reconstruct"): _empty for module in _MODULES},
    **{(module, "scalar"): np._core.multiarray.scalar for module in _MODULES},  # type: ignore[attr-defined]
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _encode,
}
"""Module and name of what a pickle may name, and what it gets."""


class _Restricted(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in ADMITTED:
            raise pickle.UnpicklingError(f"{module}.{name}")
        return ADMITTED[module, name]


def read_plain(content: bytes, source: str) -> Any:
    """What an `.npy` holds: an array of numbers as it is, an object as dictionaries and lists. Raises `InputError`."""
    stream = io.BytesIO(content)
    try:
        version = npy.read_magic(stream)
        header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = header(stream)
        if dtype != np.dtype(object):
            return np.load(io.BytesIO(content), allow_pickle=False)
        if shape not in ((), (1,)):
            raise InputError(source, "", EXPECTED, f"objects of shape {shape}")
        found = _Restricted(stream, encoding="latin1").load()
    except InputError:
        raise
    except Exception as error:  # a damaged pickle raises anything: it is refused, with what it raised
        raise InputError(source, "", EXPECTED, str(error) or type(error).__name__) from None
    return found.item() if isinstance(found, np.ndarray) and found.size == 1 else found


def flat_numbers(value: Any, count: int, source: str, field: str) -> np.ndarray:
    """(count,) float64 of numbers nested somehow; lists that repeat each other a billion times are not followed. Raises `InputError`."""
    waiting, found = [value], []
    for _ in range(4 * count + 4):
        if not waiting:
            break
        item = waiting.pop()
        if isinstance(item, list | tuple) and len(item) <= count:
            waiting.extend(reversed(item))
        elif isinstance(item, int | float | np.generic | np.ndarray) and np.size(item) <= count:
            found.append(np.ravel(item))
        else:
            raise InputError(source, field, f"{count} numbers", type(item).__name__)
    flat = np.concatenate(found) if found else np.zeros(0)
    if waiting or len(flat) != count or flat.dtype.kind not in "fiu" or not np.isfinite(flat).all():
        raise InputError(source, field, f"{count} finite numbers", f"{len(flat)} of {flat.dtype}")
    return np.asarray(flat, np.float64)
