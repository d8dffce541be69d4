"""The avatar that is open, in the interface's process: its templates for framing, its surface for `live`.

Reading one takes a second: a thread does it, and who cannot wait looks again later.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar


class Avatars:
    """Reads avatars by name or path and keeps the last."""

    def __init__(self, load: Callable[[str], Avatar] = load_avatar) -> None:
        self._load = load
        self._threads = ThreadPoolExecutor(1, "avatar")
        self._name: str | None = None
        self._reading: Future[Avatar] = Future()

    def get(self, name: str) -> Avatar:
        """The avatar, waited for. Raises `InputError`, and then keeps the one before."""
        reading = self._reading if name == self._name else self.read(name)
        avatar = reading.result()
        self.keep(name, reading)
        return avatar

    def read(self, name: str) -> Future[Avatar]:
        """Begin to read an avatar beside the open one. May be called by any thread."""
        return self._threads.submit(self._load, name)

    def keep(self, name: str, reading: Future[Avatar]) -> None:
        """Have what `read` began as the open one."""
        self._name, self._reading = name, reading

    def ready(self, name: str) -> Avatar | None:
        """The avatar where it has been read; None meanwhile, and where it cannot be."""
        if name != self._name:
            self.keep(name, self.read(name))
        done = self._reading.done() and self._reading.exception() is None
        return self._reading.result() if done else None

    def read_again(self, name: str) -> None:
        """Read the avatar anew, where it is the open one: its file has changed."""
        if name == self._name:
            self._reading = self.read(name)

    @property
    def reading(self) -> bool:
        """Whether one is being read."""
        return self._name is not None and not self._reading.done()

    def close(self) -> None:
        """End the thread."""
        self._threads.shutdown(wait=False, cancel_futures=True)
