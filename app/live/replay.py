"""Recorded landmarks that drive a layer as a camera would: in their own time, over and over."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from avatarrex_studio.live.received import Received
from avatarrex_studio.live.receiver import Counts
from avatarrex_studio.live.webcam import replayed

from avatarrex.errors import InputError

RECORDED = ".jsonl"
"""What a file of recorded landmarks ends in."""
BETWEEN = 1 / 30
"""Seconds from the last line to the first."""


class Replay:
    """A file that is played in a thread from the moment that this is made until `close`."""

    def __init__(self, path: str, arrived: Callable[[], None] = lambda: None) -> None:
        """`path`: lines as `webcam.py` describes them. Raises `InputError` for a file without one, or with another."""
        self.where = Path(path).name
        self._lines = tuple(replayed(path))
        if not self._lines:
            raise InputError(path, "", "a line of recorded landmarks or more", "none")
        self._arrived, self._lock, self._over = arrived, threading.Lock(), threading.Event()
        self._latest: tuple[Received, float] = Received(), float("-inf")
        self._played = 0
        self._thread = threading.Thread(target=self._play, name="recorded landmarks", daemon=True)
        self._thread.start()

    @property
    def counts(self) -> Counts:
        """Lines that were played, and how many a second there are."""
        seconds = self._lines[-1][0] - self._lines[0][0] + BETWEEN
        return Counts(self._played, rate=round(len(self._lines) / max(seconds, BETWEEN)))

    def latest(self) -> tuple[Received, float]:
        """The last line that was played, and when."""
        with self._lock:
            return self._latest

    def close(self) -> None:
        """Play no more."""
        self._over.set()
        self._thread.join(2.0)

    def _play(self) -> None:
        begun, first = time.monotonic(), self._lines[0][0]
        while True:
            for seconds, received in self._lines:
                if self._over.wait(max(begun + seconds - first - time.monotonic(), 0.0)):
                    return
                with self._lock:
                    self._latest = received, time.monotonic()
                self._played += 1
                self._arrived()
            begun = time.monotonic() + BETWEEN
