"""The avatars of a session's figures, in the interface's process: their templates for framing, their surfaces for `live`.

Reading one takes a second: a thread does it, and who cannot wait looks again later. The open one is not read again as long as its
files are as they were: a session that is opened mostly has the avatar that is there. Once they have changed (a training wrote it
anew) it is, and what was read before stays until that is done.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from weakref import WeakKeyDictionary

from avatarrex_studio.session.notice import refusals_logged

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import avatar_stamp, load_avatar
from avatarrex.files.stamp import Stamp

EVERY = 1.0
"""Seconds between two looks at the files of open avatars; what was written between them may not be whole yet."""


class Avatars:
    """Reads avatars by name or path and keeps those that were looked for together."""

    def __init__(self, load: Callable[[str], Avatar] = load_avatar) -> None:
        self._load = load
        self._threads = ThreadPoolExecutor(1, "avatar")
        self._aside: list[ThreadPoolExecutor] = []
        """Which may still read what waits behind something that was cancelled."""
        self._readings: dict[str, Future[Avatar]] = {}
        self._stamps: WeakKeyDictionary[Future[Avatar], Stamp] = WeakKeyDictionary()
        """Of when a reading began."""
        self._renewals: dict[str, Future[Avatar]] = {}
        """Of open ones whose files have changed."""
        self._refused: dict[str, Stamp] = {}
        """Of files that could not be read anew."""
        self._seen: dict[str, Stamp] = {}
        """At the last look at the files of open ones."""
        self._looked_at = 0.0

    def get(self, name: str) -> Avatar:
        """The avatar, waited for. Raises `InputError`, and then keeps what was there before."""
        reading = self._readings.get(name) or self.read(name)
        avatar = reading.result()
        self.keep(name, reading)
        return avatar

    def read(self, name: str) -> Future[Avatar]:
        """Begin to read an avatar beside those that are open, or an open one's reading, where that is it. May be called by any thread."""
        stamp, reading = avatar_stamp(name), self._readings.get(name)
        if reading is not None and stamp and stamp == self._stamps.get(reading) and not _failed(reading):
            return reading
        return self._begin(name, stamp)

    def keep(self, name: str, reading: Future[Avatar]) -> None:
        """Have what `read` began as an open one."""
        self._readings[name] = reading
        self._renewals.pop(name, None)

    def ready(self, name: str) -> Avatar | None:
        """The avatar where it has been read; None meanwhile, and where it cannot be."""
        if name not in self._readings:
            self.keep(name, self.read(name))
        reading = self._readings[name]
        return reading.result() if reading.done() and not _failed(reading) else None

    def stamp(self, name: str) -> Stamp:
        """That of the files which the avatar of `ready` was read from; empty where there is none."""
        reading = self._readings.get(name)
        return () if reading is None else self._stamps.get(reading, ())

    def all_ready(self, names: Iterable[str]) -> list[Avatar | None]:
        """The same of all figures; other avatars are let go of."""
        listed = list(names)
        for name in self._readings.keys() - set(listed):
            del self._readings[name]
            self._renewals.pop(name, None)
            self._refused.pop(name, None)
        return [self.ready(name) for name in listed]

    def notice(self, now: float) -> None:
        """Begin to read anew what is open and whose files have changed, and have it once it has been read; `now` in seconds.

        What cannot be read is said once, and what was there before stays.
        """
        for name, renewal in [(name, renewal) for name, renewal in self._renewals.items() if renewal.done()]:
            self._refused[name] = self._stamps.get(self._renewals.pop(name), ())
            with refusals_logged():
                renewal.result()
                self.keep(name, renewal)
        if now - self._looked_at < EVERY:
            return
        before, self._seen = self._seen, {name: avatar_stamp(name) for name in self._readings}
        self._looked_at = now
        for name, reading in self._readings.items():
            stamp = self._seen[name]
            known = (self._stamps.get(reading), self._refused.get(name), ())
            if stamp == before.get(name) and stamp not in known and reading.done() and name not in self._renewals:
                self._renewals[name] = self._begin(name, stamp)

    def step_aside(self) -> None:
        """Whatever is being read, and may be cancelled, holds up no other from now on."""
        self._threads.shutdown(wait=False)
        self._aside.append(self._threads)
        self._threads = ThreadPoolExecutor(1, "avatar")

    @property
    def reading(self) -> bool:
        """Whether one is being read."""
        return not all(reading.done() for reading in (*self._readings.values(), *self._renewals.values()))

    def close(self) -> None:
        """End the threads, once they have read what they are at."""
        for threads in (*self._aside, self._threads):
            threads.shutdown(wait=False, cancel_futures=True)

    def _begin(self, name: str, stamp: Stamp) -> Future[Avatar]:
        reading = self._threads.submit(self._load, name)
        self._stamps[reading] = stamp
        return reading


def _failed(reading: Future[Avatar]) -> bool:
    return reading.done() and reading.exception() is not None
