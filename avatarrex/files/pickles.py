"""Pickles of models and captures, read without `pickle`: a stack machine makes numbers, texts, lists, dicts and arrays, and nothing else.

No class is looked up and nothing is called: the few globals that such files name (`ADMITTED`) are words with a meaning here, any other is
refused by name. A chumpy object is the array that it stands for; `scipy.sparse` matrices are checked. What a file makes takes
no more than a limit, since lengths are compared with what is left of the file, and arrays that share bytes are counted each.
Python 2's texts are Latin-1, as NumPy's arrays in them need. The machine: Python's `pickletools`, which documents each opcode.
"""

from __future__ import annotations

import codecs
import os
import pickletools
import re
import tokenize
import warnings
from collections.abc import Callable, Iterator
from io import BufferedIOBase, BytesIO
from pathlib import Path
from typing import Any

from numpy.lib import format as npy

from avatarrex.errors import InputError
from avatarrex.files.gate import check_file
from avatarrex.files.pickled_objects import ADMITTED, NAMES, Budget, Global, Pickled, checked_key, plain_values
from avatarrex.files.zips import refusing

PICKLE_BYTES = 2**30
"""Bytes of the largest file, and of the arrays in it: SMPL-X as a pickle of protocol 0 has 520 MB."""
MOST_STEPS = 2_000_000
"""Opcodes that are read: a model file has some hundreds."""
BROKEN = (
    ValueError, IndexError, KeyError, TypeError, UnicodeError, OverflowError, MemoryError, AttributeError, RecursionError, SyntaxError,
    tokenize.TokenError,
)  # fmt: skip
"""What a damaged pickle makes the machine or `pickletools` raise, and a damaged header NumPy's reader."""
_OPCODES = {opcode.code.encode("latin-1"): opcode for opcode in pickletools.opcodes}
_MARK = object()


def read_pickle(source: str | Path | bytes, expected: str, largest: int = PICKLE_BYTES, place: str | Path = "") -> Any:
    """What a pickle, or an `.npy` file that holds one object, contains: a path, or its bytes, called `place` in errors.

    Raises `InputError`: `expected` says what it should be; neither the file nor its arrays take more than `largest` bytes.
    """
    place = place or ("bytes" if isinstance(source, bytes) else source)
    with (
        refusing(place, "", f"{expected} that is whole", (*BROKEN, OSError)),
        _opened(source, expected, largest) as file,
    ):
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        scalar = _skip_header(file, place)
        machine = _Machine(_Stream(file, size - file.tell()), largest, place)
        with warnings.catch_warnings(action="ignore"):  # a backslash before another letter stands for itself
            made = machine.run()
        value = plain_values(made, place)
    return value[0] if scalar and isinstance(value, list) and len(value) == 1 else value


def _opened(source: str | Path | bytes, expected: str, largest: int) -> BufferedIOBase:
    """A file to read from. Raises `InputError` for one that is too large."""
    if isinstance(source, bytes):
        return BytesIO(source)
    check_file(source, expected, largest)
    return open(source, "rb")


def _skip_header(file: BufferedIOBase, path: str | Path) -> bool:
    """Whether the file is an `.npy` of one object; its header is passed over. Raises `InputError` for one of numbers."""
    start = file.read(len(npy.MAGIC_PREFIX))
    file.seek(0)
    if start != npy.MAGIC_PREFIX:
        return False
    version = npy.read_magic(file)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(file)
    if not dtype.hasobject or shape != ():
        raise InputError(path, "", "an array file of one object, a dict", f"shape {shape} of {dtype}")
    return True


class _Stream:
    """A file of which nobody can read more than is left."""

    def __init__(self, file: BufferedIOBase, left: int) -> None:
        self._file, self.left = file, left

    def read(self, count: int) -> bytes:
        content = self._file.read(max(min(count, self.left), 0))
        self.left -= len(content)
        return content

    def readline(self) -> bytes:
        line = self._file.readline(self.left)
        self.left -= len(line)
        return line

    def tell(self) -> int:
        return self._file.tell()


class _Machine:
    """The stack of a pickle, and what it has named for later."""

    def __init__(self, stream: _Stream, largest: int, source: str | Path) -> None:
        self.stream: Any = stream
        self.source = source
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.budget = Budget(largest, source)

    def run(self) -> Any:
        """What lies on top at the end. Raises `InputError` and what `BROKEN` names."""
        for name, argument in self._opcodes():
            if name in _VALUES:
                self.stack.append(argument)
            elif name in _CONSTANTS:
                self.stack.append(_CONSTANTS[name]())
            else:
                step = getattr(self, f"_{name.lower()}", None)
                if step is None:
                    raise InputError(self.source, f"byte {self.stream.tell()}", NAMES, f"the opcode {name}")
                step(argument)
        return self.stack.pop()

    def _opcodes(self) -> Iterator[tuple[str, Any]]:
        """Names and arguments up to STOP."""
        for _ in range(MOST_STEPS):
            opcode = _OPCODES[self.stream.read(1)]
            if opcode.name == "STOP":
                return
            if opcode.name == "STRING":
                yield opcode.name, _quoted(self.stream.readline())
                continue
            argument = opcode.arg.reader(self.stream) if opcode.arg else None
            if opcode.name not in ("PROTO", "FRAME"):
                yield opcode.name, argument
        raise InputError(self.source, "", f"a pickle of at most {MOST_STEPS:,} opcodes", "more")

    def _above_mark(self) -> list[Any]:
        """What lies above the last mark, which is taken off with it."""
        at = len(self.stack) - 1
        while self.stack[at] is not _MARK:
            at -= 1
            if at < 0:
                raise ValueError("no mark on the stack")
        found = self.stack[at + 1 :]
        del self.stack[at:]
        return found

    def _mark(self, _: None) -> None:
        self.stack.append(_MARK)

    def _pop(self, _: None) -> None:
        self.stack.pop()

    def _pop_mark(self, _: None) -> None:
        self._above_mark()

    def _dup(self, _: None) -> None:
        self.stack.append(self.stack[-1])

    def _tuple(self, _: None) -> None:
        self.stack.append(tuple(self._above_mark()))

    def _list(self, _: None) -> None:
        self.stack.append(self._above_mark())

    def _dict(self, _: None) -> None:
        self.stack.append(_pairs(self._above_mark()))

    def _tuple1(self, _: None) -> None:
        self._last(1)

    def _tuple2(self, _: None) -> None:
        self._last(2)

    def _tuple3(self, _: None) -> None:
        self._last(3)

    def _last(self, count: int) -> None:
        found = tuple(self.stack.pop() for _ in range(count))
        self.stack.append(found[::-1])

    def _append(self, _: None) -> None:
        value = self.stack.pop()
        self._appendable().append(value)

    def _appends(self, _: None) -> None:
        values = self._above_mark()
        self._appendable().extend(values)

    def _appendable(self) -> list[Any]:
        if not isinstance(self.stack[-1], list):
            raise TypeError("an item is added to what is no list")
        return self.stack[-1]

    def _setitem(self, _: None) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._settable()[checked_key(key)] = value

    def _setitems(self, _: None) -> None:
        values = self._above_mark()
        self._settable().update(_pairs(values))

    def _settable(self) -> dict[Any, Any]:
        if not isinstance(self.stack[-1], dict):
            raise TypeError("a key is set in what is no dict")
        return self.stack[-1]

    def _put(self, index: int) -> None:
        self.memo[index] = self.stack[-1]

    _binput = _long_binput = _put

    def _memoize(self, _: None) -> None:
        self.memo[len(self.memo)] = self.stack[-1]

    def _get(self, index: int) -> None:
        self.stack.append(self.memo[index])

    _binget = _long_binget = _get

    def _global(self, names: str) -> None:
        self._admit(*names.split(" ", 1))

    def _stack_global(self, _: None) -> None:
        name, module = self.stack.pop(), self.stack.pop()
        self._admit(module, name)

    def _inst(self, names: str) -> None:
        arguments = tuple(self._above_mark())
        self._global(names)
        self._make(self.stack.pop(), arguments)

    def _admit(self, module: object, name: object) -> None:
        if not isinstance(module, str) or not isinstance(name, str):
            raise TypeError("a global whose name is no text")
        if (module, name) not in ADMITTED:
            raise InputError(self.source, f"byte {self.stream.tell()}", NAMES, f"the global {module}.{name}")
        self.stack.append(Global(module, name))

    def _reduce(self, _: None) -> None:
        arguments, of = self.stack.pop(), self.stack.pop()
        self._make(of, arguments)

    _newobj = _reduce

    def _make(self, of: object, arguments: object) -> None:
        if not isinstance(of, Global) or not isinstance(arguments, tuple):
            raise TypeError("what is no global is called")
        self.stack.append(of.made(arguments, self.budget))

    def _build(self, _: None) -> None:
        state, of = self.stack.pop(), self.stack[-1]
        if not isinstance(of, Pickled):
            raise TypeError("what has no state is given one")
        of.build(state, self.budget)


_VALUES = (
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "STRING", "BINSTRING",
    "SHORT_BINSTRING", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8", "UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8",
)  # fmt: skip
"""Opcodes that lay their argument on the stack."""
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None, "NEWTRUE": lambda: True, "NEWFALSE": lambda: False,
    "EMPTY_LIST": list, "EMPTY_TUPLE": tuple, "EMPTY_DICT": dict,
}  # fmt: skip


def _pairs(values: list[Any]) -> dict[Any, Any]:
    """Keys and values by turns."""
    return dict(zip(map(checked_key, values[::2]), values[1::2], strict=True))


def _quoted(line: bytes) -> str:
    """A text of protocol 0 in its quotes; its bytes may be any, unlike `pickletools` has it."""
    match = re.fullmatch(rb"(['\"])(.*)\1\n", line, re.DOTALL)
    if match is None:
        raise ValueError("a text without its quotes")
    return codecs.escape_decode(match[2])[0].decode("latin-1")
