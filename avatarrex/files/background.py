"""Background work: writing what was just made while the next is being made."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

WAITING = 4
"""Pieces of work that may wait; whoever brings more waits, too: they contain pictures."""


Do = Callable[..., None]
"""`do(function, *arguments, **named)` has a function called by a thread."""


@contextmanager
def background_writer(threads: int = 1) -> Iterator[Do]:
    """`do(function, *arguments)` on `threads` threads; one keeps the order. All is done when the block ends.

    The first error of the work is raised in the block, at the latest at its end. Where the block itself fails, what was
    brought before is still done, and the block's error is the one that is seen.
    """
    waiting: deque[Future[object]] = deque()
    with ThreadPoolExecutor(threads, "background writer") as pool:

        def do(function: Callable[..., object], /, *arguments: object, **named: object) -> None:
            waiting.append(pool.submit(function, *arguments, **named))
            while waiting and (waiting[0].done() or len(waiting) > WAITING):
                waiting.popleft().result()

        yield do
        while waiting:
            waiting.popleft().result()
