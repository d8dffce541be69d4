"""Ctrl+C while a training works: it ends after the step, with its checkpoint written; a second one ends at once."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm


class Interruption:
    """Whether a stop was requested by Ctrl+C."""

    def __init__(self) -> None:
        self.requested = False

    @contextmanager
    def handled(self) -> Iterator[None]:
        """While this lasts, in the main thread; in others control.json alone stops a training."""
        try:
            before = signal.signal(signal.SIGINT, self._request)
        except ValueError:  # not in the main thread
            yield
            return
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _request(self, number: int, frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        tqdm.write("stopping after this step (Ctrl+C again: at once)")
