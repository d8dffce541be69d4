"""Independent work side by side, a thread each: what waits in one is computed in another."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import torch

Made = TypeVar("Made")


def side_by_side(tasks: Sequence[Callable[[], Made]]) -> list[Made]:
    """What each of the `tasks` returns. As many at once as torch has threads; each then has one. The first error is raised."""
    threads = min(torch.get_num_threads(), len(tasks))
    if threads == 1:
        return [task() for task in tasks]
    before = torch.get_num_threads()
    pool = _pool(threads - 1)
    results: dict[int, Made] = {}
    rest, lock = iter(enumerate(tasks)), threading.Lock()

    def work() -> None:
        torch.set_num_threads(1)
        while True:
            with lock:
                number, task = next(rest, (-1, None))
            if task is None:
                return
            results[number] = task()

    others = [pool.submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        for other in others:
            other.exception()
        torch.set_num_threads(before)
    for other in others:
        other.result()
    return [results[number] for number in range(len(tasks))]


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "tasks")
