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
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch
from numba import njit
from torch import Tensor

FOLDER = Path(__file__).parent
FEW = 4096
"""Rows up to which one thread is done before others have started."""


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


def spread(loop: Callable[..., Any], rows: int, *arguments: Any, few: int = FEW) -> None:
    """`loop(begin, end, *arguments)` over pieces of the rows, one for each of torch's threads; `few` rows take one."""
    pieces = torch.get_num_threads() if rows > few else 1
    edges = [rows * piece // pieces for piece in range(pieces + 1)]
    if pieces == 1:
        loop(0, rows, *arguments)
        return
    others = [_pool(pieces - 1).submit(loop, *edge, *arguments) for edge in itertools.pairwise(edges[1:])]
    loop(edges[0], edges[1], *arguments)
    for other in others:
        other.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "native")


if hasattr(os, "register_at_fork"):  # a child has none of the threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
