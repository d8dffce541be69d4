"""The avatar that is open, in the interface's process: its templates for framing, its surface for `live`.

Reading one takes a second: a thread does it, and who cannot wait looks again later. The open one is not read again as long as its
files are as they were: a session that is opened mostly has the avatar that is there.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from weakref import WeakKeyDictionary

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import Stamp, avatar_stamp, load_avatar


class Avatars:
    """Reads avatars by name or path and keeps the last."""

    def __init__(self, load: Callable[[str], Avatar] = load_avatar) -> None:
        self._load = load
        self._threads = ThreadPoolExecutor(1, "avatar")
        self._open: tuple[str | None, Future[Avatar]] = (None, Future())
        """The name of the open one, and its reading."""
        self._stamps: WeakKeyDictionary[Future[Avatar], Stamp] = WeakKeyDictionary()
        """Of when a reading began."""

    def get(self, name: str) -> Avatar:
        """The avatar, waited for. Raises `InputError`, and then keeps the one before."""
        opened, reading = self._open
        reading = reading if name == opened else self.read(name)
        avatar = reading.result()
        self.keep(name, reading)
        return avatar

    def read(self, name: str) -> Future[Avatar]:
        """Begin to read an avatar beside the open one, or the open one's reading, where that is it. May be called by any thread."""
        opened, reading = self._open
        stamp = avatar_stamp(name)
        if name == opened and stamp and stamp == self._stamps.get(reading) and not _failed(reading):
            return reading
        return self._begin(name, stamp)

    def keep(self, name: str, reading: Future[Avatar]) -> None:
        """Have what `read` began as the open one."""
        self._open = name, reading

    def ready(self, name: str) -> Avatar | None:
        """The avatar where it has been read; None meanwhile, and where it cannot be."""
        if name != self._open[0]:
            self.keep(name, self.read(name))
        reading = self._open[1]
        return reading.result() if reading.done() and not _failed(reading) else None

    def read_again(self, name: str) -> None:
        """Read the avatar anew, where it is the open one: its file has changed."""
        if name == self._open[0]:
            self.keep(name, self._begin(name, avatar_stamp(name)))

    @property
    def reading(self) -> bool:
        """Whether one is being read."""
        name, reading = self._open
        return name is not None and not reading.done()

    def close(self) -> None:
        """End the thread."""
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _begin(self, name: str, stamp: Stamp) -> Future[Avatar]:
        reading = self._threads.submit(self._load, name)
        self._stamps[reading] = stamp
        return reading


def _failed(reading: Future[Avatar]) -> bool:
    return reading.done() and reading.exception() is not None
