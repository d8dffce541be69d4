"""Loops over points that neither torch nor numpy has an operation for, compiled by numba for a CPU.

Each has the torch operations that it replaces as its reference in the tests; those also serve gradients, float64 and other devices
(a search tree is float64 itself, and has no gradient). No fused products, unless a loop
allows them: a number that is computed at two places is the same at both.

A compiled loop is kept on disk by numba's cache, beside its source or in the user's cache folder: a machine compiles each once, all
of them in fifteen seconds. numba's own key is the hash of the loop's file alone. Loops also call functions and use constants of
other files of this folder, so the key here is the hash of the loop's file and of all files of this folder: whatever changes there,
the loop is compiled anew. A loop must take nothing from elsewhere.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch
from numba import njit
from torch import Tensor

FOLDER = Path(__file__).parent
FEW = 4096
"""Rows up to which one thread is done before others have started."""
PIECES = 4
"""Of the work for each thread."""
_threads: ContextVar[int] = ContextVar("threads", default=0)
"""Those of compiled loops where torch has fewer; 0: as many as torch."""


@cache
def source_hash(file: str) -> str:
    """Of the text of a loop's file and of all Python files of this folder."""
    digest = hashlib.sha256()
    for source in (Path(file), *sorted(FOLDER.glob("*.py"))):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def native(loop: Callable[..., Any], fused: bool = False, borrows: bool = False) -> Any:
    """The compiled `loop`, out of what the tests' type checker wrapped around it: it runs without Python's lock.

    `fused`: a product and a sum may be rounded once, for loops whose numbers are computed nowhere else. `borrows`: no references
    are counted, which takes half the time of a short function; it must neither make an array nor return one.
    """
    function = inspect.unwrap(loop)
    fast = {"contract"} if fused else False
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": fast, "_nrt": not borrows}
    try:
        compiled = njit(function, cache=True, **options)
    except RuntimeError:  # neither the program's folder nor the user's can be written: compiled anew by every process
        return njit(function, **options)
    compiled._cache._cache_file._source_stamp = source_hash(inspect.getfile(function))  # numba has no public way
    return compiled


borrowing = partial(native, borrows=True)


def serves(*tensors: Tensor) -> bool:
    """Whether compiled loops may take these: float32 on a CPU, and no gradients are wanted."""
    return all(
        tensor.device.type == "cpu"
        and tensor.dtype == torch.float32
        and not (torch.is_grad_enabled() and tensor.requires_grad)
        for tensor in tensors
    )


def threads() -> int:
    """Of the compiled loops: as many as torch has, or had before `torch_on_one_thread`."""
    return _threads.get() or torch.get_num_threads()


@contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """Meanwhile torch's own operations run on the thread that calls them; compiled loops keep their threads.

    After every operation OpenMP's threads wait for the last one, which another program may keep from running for milliseconds;
    then they spin, on the core that the thread of a compiled loop needs next.
    """
    with loops_on(threads()):
        yield


@contextmanager
def one_thread() -> Iterator[None]:
    """Meanwhile compiled loops and torch's operations run on the thread that calls them."""
    with loops_on(1):
        yield


@contextmanager
def loops_on(count: int) -> Iterator[None]:
    """Meanwhile compiled loops have `count` threads, torch one, in the thread that calls this."""
    before, token = torch.get_num_threads(), _threads.set(count)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _threads.reset(token)


def spread(loop: Callable[..., Any], rows: int, *arguments: Any, few: int = FEW, pieces: int = PIECES) -> None:
    """`loop(begin, end, *arguments)` over pieces of the rows, `pieces` for each thread; there is one for every `few` rows.

    There are at most `threads()`. A thread takes the next piece when it has done its last. One that another program keeps
    from running holds up its own piece alone, and none where it has not begun.
    """
    count = min(threads(), max(-(-rows // few), 1))
    if count == 1:
        loop(0, rows, *arguments)
        return
    edges = itertools.pairwise([rows * piece // (pieces * count) for piece in range(pieces * count + 1)])
    next_edge = threading.Lock()

    def work() -> None:
        while True:
            with next_edge:
                edge = next(edges, None)
            if edge is None:
                return
            loop(*edge, *arguments)

    others = [_pool().submit(work) for _ in range(count - 1)]
    work()
    for other in others:
        if not other.cancel():
            other.result()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), "native")


if hasattr(os, "register_at_fork"):  # a child has none of the threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
