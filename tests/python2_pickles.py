"""Pickles as Python 2 wrote them, and chumpy's and SciPy's classes under the names that those files give."""

from __future__ import annotations

import io
import pickle
import sys
import types
from pathlib import Path
from typing import Any, ClassVar

import numpy as np


class Python2Pickler(pickle._Pickler):
    """Texts and bytes are Python 2's `str`; modules have the names of that time."""

    dispatch: ClassVar = dict(pickle._Pickler.dispatch)

    def save_text(self, value: bytes | str) -> None:
        content = value.encode("latin-1") if isinstance(value, str) else value
        if self.proto == 0:
            text = content.decode("latin-1").encode("unicode_escape").replace(b"'", b"\\'")
            self.write(pickle.STRING + b"'" + text + b"'\n")
        elif len(content) < 256:
            self.write(pickle.SHORT_BINSTRING + bytes([len(content)]) + content)
        else:
            self.write(pickle.BINSTRING + len(content).to_bytes(4, "little") + content)
        self.memoize(value)

    def save_global(self, value: Any, name: str | None = None) -> None:
        renamed = {"numpy._core.multiarray": "numpy.core.multiarray", "scipy.sparse._csc": "scipy.sparse.csc"}
        module = renamed.get(getattr(value, "__module__", ""))
        if module is None:
            super().save_global(value, name)
            return
        self.write(pickle.GLOBAL + f"{module}\n{name or value.__qualname__}\n".encode())
        self.memoize(value)

    dispatch[bytes] = dispatch[str] = save_text
    dispatch[type] = save_global
    dispatch[types.FunctionType] = save_global


class Ch:
    """`chumpy.ch.Ch`, as much as a pickle knows of it: `x`, and what it keeps besides."""

    def __init__(self, x: np.ndarray) -> None:
        self.x, self._dirty_vars, self._itr, self._status = x, {"x"}, None, "new"


class Select(Ch):
    """`chumpy.reordering.Select`: some numbers of `a`."""

    def __init__(self, a: Ch, idxs: np.ndarray, preferred_shape: tuple[int, ...]) -> None:
        self.a, self.idxs, self.preferred_shape, self._dirty_vars = a, idxs, preferred_shape, {"a"}


Ch.__module__, Select.__module__ = "chumpy.ch", "chumpy.reordering"


def chumpy(value: np.ndarray) -> Ch:
    """As most arrays of a model are kept."""
    return Ch(value)


def selected(value: np.ndarray) -> Select:
    """As shape directions are: every second number of an array twice as long."""
    doubled = np.repeat(value.ravel(), 2)
    return Select(Ch(doubled), np.arange(0, doubled.size, 2), value.shape)


def python2_pickle(value: Any, protocol: int = 2) -> bytes:
    """The file's content."""
    modules = {"chumpy": types.ModuleType("chumpy")}
    for kind in (Ch, Select):
        modules[kind.__module__] = types.ModuleType(kind.__module__)
        setattr(modules[kind.__module__], kind.__name__, kind)
    stream = io.BytesIO()
    sys.modules.update(modules)
    try:
        Python2Pickler(stream, protocol).dump(value)
    finally:
        for name in modules:
            del sys.modules[name]
    return stream.getvalue()


def write_python2(path: Path, value: Any, protocol: int = 2) -> Path:
    """A pickle of Python 2's."""
    path.write_bytes(python2_pickle(value, protocol))
    return path


def write_object_array(path: Path, value: Any) -> Path:
    """An `.npy` that holds one object, as `np.save` writes a dict."""
    np.save(path, np.array(value, dtype=object), allow_pickle=True)
    return path
