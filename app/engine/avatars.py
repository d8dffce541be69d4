"""The avatars of a session's figures, in the interface's process: their templates for framing, their surfaces for `live`.

Reading one takes a second: a thread does it, and who cannot wait looks again later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar


class Avatars:
    """Reads avatars by name or path and keeps those that were looked for together."""

    def __init__(self, load: Callable[[str], Avatar] = load_avatar) -> None:
        self._load = load
        self._threads = ThreadPoolExecutor(1, "avatar")
        self._readings: dict[str, Future[Avatar]] = {}

    def get(self, name: str) -> Avatar:
        """The avatar, waited for. Raises `InputError`, and then keeps what was there before."""
        reading = self._readings.get(name) or self.read(name)
        avatar = reading.result()
        self.keep(name, reading)
        return avatar

    def read(self, name: str) -> Future[Avatar]:
        """Begin to read an avatar beside those that are open. May be called by any thread."""
        return self._threads.submit(self._load, name)

    def keep(self, name: str, reading: Future[Avatar]) -> None:
        """Have what `read` began as an open one."""
        self._readings[name] = reading

    def ready(self, name: str) -> Avatar | None:
        """The avatar where it has been read; None meanwhile, and where it cannot be."""
        if name not in self._readings:
            self.keep(name, self.read(name))
        reading = self._readings[name]
        done = reading.done() and reading.exception() is None
        return reading.result() if done else None

    def all_ready(self, names: Iterable[str]) -> list[Avatar | None]:
        """The same of all figures; other avatars are let go of."""
        listed = list(names)
        self._readings = {name: reading for name, reading in self._readings.items() if name in listed}
        return [self.ready(name) for name in listed]

    def read_again(self, name: str) -> None:
        """Read the avatar anew, where it is open: its file has changed."""
        if name in self._readings:
            self.keep(name, self.read(name))

    @property
    def reading(self) -> bool:
        """Whether one is being read."""
        return not all(reading.done() for reading in self._readings.values())

    def close(self) -> None:
        """End the thread."""
        self._threads.shutdown(wait=False, cancel_futures=True)
