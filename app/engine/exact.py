"""The exact engine in a process of its own: the interface sends requests, polls for answers and never waits for it.

One request is under way at a time. Of pictures that are not begun the newest alone is kept. A process that dies is
reported and started again; what it was rendering is tried once more. It ends with this one, whatever way that ends: its
pipe breaks.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import Empty, SimpleQueue

from avatarrex_studio.engine.request import Answer, Request
from avatarrex_studio.engine.slices import receive
from avatarrex_studio.engine.worker import CANCEL, READY, Make, serve

log = logging.getLogger(__name__)
TRIES = 2
"""How often a request may end the process before it counts as what ends it."""
FAREWELL = 1.0
"""Seconds that the process may take to end."""


class ExactEngine:
    """Renders in another process. `make(between)` makes its `Engine` there, and must be importable."""

    def __init__(self, make: Make, later: bool = False) -> None:
        """With `later` the process is not started before `begin`, or the first request: it would slow down what else starts."""
        self._make = make
        self.arrived: Callable[[], None] = lambda: None
        """Called by another thread when there may be something to poll: an interface that sleeps on events is woken."""
        self._picture: Request | None = None
        self._files: deque[Request] = deque()
        self._dropped: deque[Request] = deque()
        self._current: Request | None = None
        self._tries = 0
        self._ready = self._closed = False
        self._inbox: SimpleQueue[object] = SimpleQueue()
        self._process: BaseProcess | None = None
        if not later:
            self._start()

    def begin(self) -> None:
        """Start the process, where there is none."""
        if self._process is None and not self._closed:
            self._start()

    @property
    def busy(self) -> bool:
        """Whether an answer is to come."""
        return bool(self._current or self._picture or self._files or self._dropped)

    @property
    def process(self) -> int | None:
        """The process's number; None while there is none."""
        return self._process.pid if self._process else None

    def request(self, request: Request) -> None:
        """Render this next; it takes the place of a picture that was not begun."""
        if request.path:
            self._files.append(request)
        else:
            self._picture = request
        self._send()

    def cancel(self) -> None:
        """Drop the picture that was not begun, and end the one under way at its next stage; files go on. Both are answered."""
        if self._picture:
            self._dropped.append(self._picture)
            self._picture = None
        if self._current and not self._current.path:
            self._write(CANCEL)

    def poll(self) -> Answer | None:
        """The next answer, where one has come."""
        if self._dropped:
            return Answer(self._dropped.popleft(), cancelled=True)
        while True:
            try:
                message = self._inbox.get_nowait()
            except Empty:
                return None
            if message == READY:
                self._ready = True
                continue
            answer = message if isinstance(message, Answer) else self._died()
            if answer:
                self._current, self._tries = None, 0
            self._send()
            if answer:
                return answer

    def close(self) -> None:
        """End the process; files that it has not written are named."""
        self._closed = True
        for request in (self._current, *self._files):
            if request and request.path:
                log.error("not written: %s", request.path)
        if self._process:
            self._process.kill()  # its pipe would break only when the thread that reads here has let go of it
            self._process.join(FAREWELL)

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would share OpenGL contexts and threads
        self._connection, theirs = context.Pipe()
        self._inbox = SimpleQueue()
        self._ready = False
        self._process = context.Process(target=serve, args=(theirs, self._make), name="exact engine", daemon=True)
        self._process.start()
        theirs.close()
        threading.Thread(target=self._receive, args=(self._connection, self._inbox), daemon=True).start()

    def _send(self) -> None:
        """Begin the next request, where none is under way."""
        if self._current or self._closed:
            return
        if self._files:
            self._current = self._files.popleft()
        elif self._picture:
            self._current, self._picture = self._picture, None
        else:
            return
        if self._process is None:
            self._start()
        self._tries += 1
        self._write(self._current)

    def _write(self, message: object) -> None:
        try:
            self._connection.send(message)
        except OSError:  # it has died, which the reading end tells, too
            log.debug("a message to the exact engine was lost")

    def _died(self) -> Answer | None:
        """Say so and start anew; the answer to what it had begun, where that ended it before."""
        assert self._process is not None
        self._process.join(FAREWELL)
        cause, ready, current = _cause(self._process.exitcode), self._ready, self._current
        self._connection.close()
        self._process = None
        if not ready:  # the next request tries again
            log.error("the exact engine does not start (%s)", cause)
        else:
            log.error("the exact engine ended (%s); it is started again", cause)
            self._start()
        if current is None:
            return None
        if not ready or self._tries >= TRIES:
            return Answer(current, error=f"the exact engine ended ({cause}) while it rendered this")
        self._current = None
        if current.path:
            self._files.appendleft(current)
        elif self._picture:
            self._tries = 0
        else:
            self._picture = current
        return None

    def _receive(self, connection: Connection, inbox: SimpleQueue[object]) -> None:
        """Bring what the process sends into `inbox`; None when it is gone."""
        try:
            while True:
                inbox.put(receive(connection))
                self.arrived()
        except (EOFError, OSError):
            inbox.put(None)
            if not self._closed:
                self.arrived()


def _cause(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"killed by {name}" + (", perhaps for want of memory" if name == "SIGKILL" else "")
    return f"exit code {code}"
