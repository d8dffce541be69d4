"""Independent work of one frame side by side.

A piece of work has loops that spread over threads, and code between them that does not. Pieces beside each other, each with
its share of the threads, leave no core idle, and their threads wait for each other once instead of at the end of every loop.
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
        threads, of_torch = native.threads(), torch.get_num_threads()
        workers = min(threads, len(self._waiting))
        if workers < 2:
            self.run_in_turn()
            return
        helping = [_pool(workers - 1).submit(self._beside, threads // workers) for _ in range(workers - 1)]
        self._beside(threads // workers)
        for helper in helping:
            if not helper.cancel():  # one that has not begun may wait for this thread
                helper.result()
        torch.set_num_threads(of_torch)  # a thread that begins later takes what was set last, by whomever

    def _beside(self, threads: int) -> None:
        with native.loops_on(threads):
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
