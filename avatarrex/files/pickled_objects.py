"""What the globals of model files stand for: NumPy arrays old and new, SciPy's sparse matrices, chumpy's arrays.

Nothing of these libraries is called with what a file says: an array is a view of bytes whose count has been compared with its shape.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array

from avatarrex.errors import InputError
from avatarrex.files.arrays import check_letters
from avatarrex.files.gate import check_bytes

NAMES = "numbers, texts, lists, dicts, NumPy arrays, SciPy csc and csr matrices, chumpy Ch and Select"
"""What is admitted, in words."""
DEEPEST = 32
"""Containers within one another; model files have three."""
_SPARSE: dict[tuple[object, object], str] = {
    (f"scipy.sparse.{mark}{kind}", f"{kind}_{noun}"): kind
    for kind in ("csc", "csr") for mark in ("", "_") for noun in ("matrix", "array")
}  # fmt: skip
_NUMPY: dict[tuple[object, object], str] = {
    (f"{core}.{module}", name): name
    for core in ("numpy.core", "numpy._core")
    for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
}
ADMITTED: dict[tuple[object, object], str] = {
    **_NUMPY, ("numpy", "ndarray"): "class", ("numpy", "dtype"): "dtype",
    **_SPARSE, ("chumpy.ch", "Ch"): "Ch", ("chumpy.reordering", "Select"): "Select",
    **{(module, "_reconstructor"): "_reconstructor" for module in ("copy_reg", "copyreg")},
    **{(module, name): name for module in ("__builtin__", "builtins") for name in ("object", "set", "bytes")},
    ("_codecs", "encode"): "encode", ("collections", "OrderedDict"): "OrderedDict",
}  # fmt: skip
"""(module, name) of every global that a file may name, and its kind."""
OBJECTS = ("csc", "csr", "Ch", "Select")
"""Kinds that have a state."""
ENTRY_BYTES, INDEX_BYTES = 128, 8
"""What an entry of a dict, and an index into an array or a list, takes."""
MOST_SIDES, LONGEST_SIDE, LONGEST_WORD = 32, 2**31, 16
"""Of an array's shape; letters of a type's code."""
_NUMBERS = re.compile(r"[fiub](?:1|2|4|8)")
_OBJECT = re.compile(r"O[48]?")
_TEXTS = re.compile(r"[SU][0-9]{1,4}")


@dataclass
class Budget:
    """Bytes that the arrays of a file may still take."""

    left: int
    source: str | Path

    def spend(self, count: int) -> None:
        """Raise `InputError` where they are too many."""
        check_bytes(count, self.source, "", "arrays", max(self.left, 0))
        self.left -= count


class Pickled:
    """What a file gives a state after it was made; `plain` is what it stands for."""

    def build(self, state: Any, budget: Budget) -> None:
        """Take the state."""
        raise NotImplementedError

    def plain(self) -> Any:
        """What it stands for."""
        raise NotImplementedError


@dataclass
class Kind(Pickled):
    """A NumPy type by its code."""

    code: str
    order: str = "="

    def build(self, state: Any, budget: Budget) -> None:
        """(version, byte order, subarray, names, fields, size, alignment, flags)."""
        if any(part is not None for part in state[2:5]) or state[1] not in ("<", ">", "|", "="):
            raise TypeError("a NumPy type with fields")
        self.order = state[1]

    @property
    def numpy(self) -> np.dtype:
        """The type, of numbers or texts."""
        if not (_NUMBERS.fullmatch(self.code) or _TEXTS.fullmatch(self.code)):
            raise TypeError(f"the NumPy type {self.code}")
        return np.dtype(self.order.replace("|", "=") + self.code)

    def plain(self) -> Any:
        """A type alone is nothing that a model holds."""
        raise TypeError("a NumPy type without an array")


@dataclass
class Array(Pickled):
    """A NumPy array, empty until its state comes."""

    value: Any = None

    def build(self, state: Any, budget: Budget) -> None:
        """(version, shape, type, whether columns run first, bytes), of an old file without the version."""
        shape, kind, fortran, content = state[-4:]
        if isinstance(kind, Kind) and _OBJECT.fullmatch(kind.code):
            if len(shape) > 1 or not isinstance(content, list) or len(content) != size_of(shape):
                raise TypeError("an array of objects that is no list")
            self.value = content
        else:
            self.value = array(content, kind, shape, "F" if fortran else "C", budget)

    def plain(self) -> Any:
        """The array; a list where it has objects."""
        if self.value is None:
            raise TypeError("an array without numbers")
        return self.value


@dataclass
class Object(Pickled):
    """A sparse matrix, or an array of chumpy's, empty until its state comes. What it has of others is complete by then."""

    kind: str
    value: Any = None

    def build(self, state: Any, budget: Budget) -> None:
        """A dict by attribute."""
        if not isinstance(state, dict):
            raise TypeError(f"a {self.kind} without a dict of attributes")
        if self.kind == "Ch":
            self.value = self._part(state, "x")
        else:
            self.value = (self._selected if self.kind == "Select" else self._sparse)(state, budget)

    def plain(self) -> Any:
        """The matrix, or the array."""
        if self.value is None:
            raise TypeError(f"a {self.kind} without its attributes")
        return self.value

    def _selected(self, state: dict[str, Any], budget: Budget) -> np.ndarray:
        """The numbers of `a` at `idxs`, in the shape `preferred_shape`."""
        values, chosen = self._part(state, "a"), self._part(state, "idxs")
        if chosen.dtype.kind not in "iu":
            raise TypeError("Select.idxs that are no integers")
        budget.spend(chosen.size * max(values.itemsize, INDEX_BYTES))
        if not values.flags.c_contiguous:  # a copy, row by row
            budget.spend(values.nbytes)
        found: np.ndarray = values.ravel()[chosen]
        shape = state.get("preferred_shape")
        if shape is None:
            return found
        if size_of(shape) != found.size:
            raise ValueError(f"{found.size} numbers for shape {tuple(shape)}")
        return found.reshape(shape)

    def _sparse(self, state: dict[str, Any], budget: Budget) -> Any:
        shape = state["_shape"] if "_shape" in state else state["shape"]
        size_of(shape)
        rows, columns = shape
        data, indices, starts = (self._part(state, name) for name in ("data", "indices", "indptr"))
        if len(starts) != (columns if self.kind == "csc" else rows) + 1:
            raise ValueError("a sparse matrix of another shape than its indices")
        budget.spend(data.nbytes + INDEX_BYTES * (indices.size + starts.size))
        made = (csc_array if self.kind == "csc" else csr_array)((data, indices, starts), shape=(rows, columns))
        made.check_format(full_check=True)
        return made

    def _part(self, state: dict[str, Any], name: str) -> np.ndarray:
        """An attribute that is an array."""
        value = state[name]
        found = value.plain() if isinstance(value, Pickled) else value
        if not isinstance(found, np.ndarray):
            raise TypeError(f"{self.kind}.{name} that is no array")
        return found


@dataclass(frozen=True)
class Global:
    """A global of `ADMITTED`."""

    module: str
    name: str

    @property
    def kind(self) -> str:
        """What it is."""
        return ADMITTED[self.module, self.name]

    def made(self, arguments: tuple[Any, ...], budget: Budget) -> Any:
        """What a file that calls it means. Raises `TypeError` and the like for arguments that it cannot have."""
        kind = self.kind
        if kind in OBJECTS:
            return Object(kind)
        if kind == "_reconstructor":
            return arguments[0].made((), budget)
        if kind == "_reconstruct":
            return Array()
        if kind == "dtype":
            return Kind(text(arguments[0]))
        if kind == "scalar":
            return array(arguments[1], arguments[0], (), "C", budget)[()]
        if kind == "_frombuffer":
            content, of, shape, order = arguments
            return array(content, of, shape, order, budget)
        if kind == "encode":
            return _encoded(arguments, budget)
        if kind in ("set", "OrderedDict"):
            return _filled(kind, arguments, budget)
        if kind == "bytes" and not arguments:
            return b""
        raise TypeError(f"{self.module}.{self.name} with arguments")


def _encoded(arguments: tuple[Any, ...], budget: Budget) -> bytes:
    """Bytes, as Python 3 writes them for Python 2."""
    content, encoding = arguments
    if not isinstance(content, str) or encoding != "latin1":
        raise TypeError("bytes of no Latin-1 text")
    budget.spend(len(content))
    return content.encode("latin-1")


def _filled(kind: str, arguments: tuple[Any, ...], budget: Budget) -> Any:
    """A set as the list, an ordered dict as a dict, of a list that the file has made."""
    given = arguments[0] if arguments else []
    if not isinstance(given, list):
        raise TypeError(f"a {kind} of no list")
    if kind == "set":
        return given
    budget.spend(ENTRY_BYTES * len(given))
    return {checked_key(key): value for key, value in given}


def checked_key(key: Any) -> Any:
    """A dict's key; of tuples within tuples a hash takes for ever. Raises `TypeError`."""
    if isinstance(key, str | bytes | np.integer) or (isinstance(key, int) and key.bit_length() < 64):
        return key
    raise TypeError(f"a key that is a {type(key).__name__}, not a text or an integer")


def size_of(shape: Any) -> int:
    """How many numbers an array of a file's `shape` has. Raises `TypeError` for what no array has."""
    if not isinstance(shape, tuple | list) or len(shape) > MOST_SIDES:
        raise TypeError("an array without shape")
    if not all(type(side) is int and 0 <= side <= LONGEST_SIDE for side in shape):
        raise TypeError("a shape of other numbers than sides")
    return math.prod(shape)


def array(content: Any, kind: Any, shape: Any, order: str, budget: Budget) -> np.ndarray:
    """An array of a file's bytes, read-only."""
    if not isinstance(kind, Kind) or not isinstance(content, str | bytes | bytearray):
        raise TypeError("an array without type or bytes")
    size = size_of(shape)
    budget.spend(len(content))
    data = content.encode("latin-1") if isinstance(content, str) else content
    if size * kind.numpy.itemsize != len(data):
        raise ValueError(f"{len(data)} bytes for shape {tuple(shape)} of {kind.code}")
    made = np.frombuffer(data, kind.numpy).reshape(shape, order="F" if order == "F" else "C")
    check_letters(made)
    return made


def text(value: Any) -> str:
    """A short text, in Python 2's bytes or not. Raises `TypeError` for anything else."""
    if not isinstance(value, str | bytes) or len(value) > LONGEST_WORD:
        raise TypeError("a type's code that is no short text")
    return value.decode("latin-1") if isinstance(value, bytes) else value


def plain_values(value: Any, source: str | Path, depth: int = 0, done: dict[int, Any] | None = None) -> Any:
    """Everything that a file has made as what it stands for; each once, so that what is named twice stays one.

    Raises `InputError` for containers that are nested too deeply, or within themselves.
    """
    done = {} if done is None else done
    if id(value) in done:
        return done[id(value)]
    if depth > DEEPEST:
        raise InputError(source, "", f"a pickle nested at most {DEEPEST} deep", "lists nested too deeply")
    if isinstance(value, Global):
        raise TypeError(f"the global {value.module}.{value.name} by itself")
    found = value.plain() if isinstance(value, Pickled) else value
    if isinstance(found, dict):
        found = {key: plain_values(item, source, depth + 1, done) for key, item in found.items()}
    elif isinstance(found, list | tuple):
        found = type(found)(plain_values(item, source, depth + 1, done) for item in found)
    done[id(value)] = found
    return found
