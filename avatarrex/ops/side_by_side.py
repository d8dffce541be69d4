"""Independent work of one frame side by side, a thread each.

A piece of work has loops that spread over threads, and code between them that does not. Two pieces beside each other, with one thread each,
leave no core idle, and their threads wait for each other once instead of at the end of every loop.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import ParamSpec, TypeVar

import torch

from avatarrex.ops import native

Takes = ParamSpec("Takes")
Made = TypeVar("Made")


class SideBySide:
    """Work that is added first, the longest first, and then run."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()

    def add(self, work: Callable[Takes, Made], *arguments: Takes.args, **named: Takes.kwargs) -> Future[Made]:
        """Its `result()`, after `run`, is what `work` returns; or raises what it raised."""
        future: Future[Made] = Future()
        gradients = torch.is_grad_enabled()  # of this thread

        def do() -> None:
            try:
                with torch.set_grad_enabled(gradients):
                    future.set_result(work(*arguments, **named))
            except BaseException as error:  # an interrupt, too, belongs to whoever takes the result
                future.set_exception(error)

        self._waiting.append(do)
        return future

    def run(self) -> None:
        """Do all of it: one after the other where there is one piece, or loops have one thread."""
        others = min(native.threads(), len(self._waiting)) - 1
        if others < 1:
            self.run_in_turn()
            return
        helping = [_pool(others).submit(self._work_alone) for _ in range(others)]
        self._work_alone()
        for helper in helping:
            helper.result()

    def _work_alone(self) -> None:
        with native.one_thread():
            self.run_in_turn()

    def run_in_turn(self) -> None:
        """Do all of it in the thread that calls this."""
        while True:
            try:
                do = self._waiting.popleft()
            except IndexError:
                return
            do()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "side-by-side")


if hasattr(os, "register_at_fork"):  # a child has none of the threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
