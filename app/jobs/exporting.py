"""Exports in the background: one process at a time writes an order, the others wait; none is waited for.

An order may take a moment to be made (a state for each frame of a motion): a thread does that.
"""

from __future__ import annotations

import logging
import multiprocessing
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from avatarrex_studio.jobs.export_order import Make, Order
from avatarrex_studio.jobs.export_worker import CANCEL, Ended, serve
from avatarrex_studio.session.notice import NOTICE

from avatarrex.errors import InputError

log = logging.getLogger(__name__)
PATIENCE = 20.0
"""Seconds that a cancelled process has to remove its temporary file; then it is killed."""
FAREWELL = 2.0
"""Seconds that a process that has said its last may take to end."""


@dataclass(frozen=True)
class Progress:
    """How far an export is."""

    path: Path
    done: int
    steps: int
    seconds: float | None
    """Left; None where nobody knows yet."""
    cancelling: bool = False
    waiting: int = 0
    """Other exports that come after it."""


@dataclass
class _Job:
    order: Order
    process: BaseProcess
    connection: Connection
    started: float
    done: int = 0
    first: float = 0.0
    """When the first step was done: what comes before is no measure of the others."""
    kill_by: float | None = None


class Exporting:
    """The exports of one window. `make()` makes an engine in the process that writes, and must be importable."""

    def __init__(self, make: Make, clock: Callable[[], float] = time.monotonic) -> None:
        self.arrived: Callable[[], None] = lambda: None
        """Called by another thread when there is something to poll."""
        self.written: list[Path] = []
        """What has been exported, the newest last."""
        self._make, self._clock = make, clock
        self._waiting: deque[Order] = deque()
        self._job: _Job | None = None

    @property
    def busy(self) -> bool:
        """Whether one is at work or waits."""
        return self._job is not None or bool(self._waiting)

    def start(self, order: Order) -> None:
        """Export this after those that wait. Raises `InputError` for what can be seen to be wrong before."""
        order.check()
        self._waiting.append(order)
        self.poll()

    @property
    def progress(self) -> Progress | None:
        """Of the one at work."""
        job = self._job
        if job is None:
            return None
        steps, seconds = job.order.steps, None
        if 1 < job.done <= steps:
            seconds = (self._clock() - job.first) / (job.done - 1) * (steps - job.done)
        return Progress(job.order.path, job.done, steps, seconds, job.kill_by is not None, len(self._waiting))

    def cancel(self) -> None:
        """End the one at work; nothing of it stays."""
        if self._job and self._job.kill_by is None:
            self._job.kill_by = self._clock() + PATIENCE
            try:
                self._job.connection.send(CANCEL)
            except OSError:
                log.debug("it has ended already")

    def poll(self) -> None:
        """Take what the process says, and begin the next."""
        job = self._job
        if job is not None:
            ended = self._read(job)
            if ended is None:
                return
            job.process.join(FAREWELL)
            job.connection.close()
            self._job = None
            self._report(job, ended)
        if self._waiting:
            self._begin(self._waiting.popleft())

    def close(self) -> None:
        """Cancel what is at work and wait until its temporary file is gone."""
        self._waiting.clear()
        job, self._job = self._job, None
        if job is None:
            return
        job.connection.close()
        job.process.join(PATIENCE)
        if job.process.exitcode is None:
            job.process.kill()
        log.warning("not exported: %s", job.order.path)

    def _begin(self, order: Order) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would share OpenGL contexts and threads
        mine, theirs = context.Pipe()
        process = context.Process(target=serve, args=(theirs, order, self._make), name="export", daemon=True)
        process.start()
        theirs.close()
        self._job = _Job(order, process, mine, self._clock())
        threading.Thread(target=self._wake, args=(mine,), daemon=True).start()

    def _wake(self, connection: Connection) -> None:
        """Tell the interface about each message, which it reads itself."""
        while True:
            try:
                ready = connection.poll(0.2)
            except OSError:  # closed, by either end
                break
            if ready:
                self.arrived()
                time.sleep(0.1)
        self.arrived()

    def _read(self, job: _Job) -> Ended | None:
        """Read messages; how it ended, None while it works."""
        try:
            while job.connection.poll():
                message = job.connection.recv()
                if isinstance(message, Ended):
                    return message
                job.done, job.first = message, job.first or self._clock()
        except (EOFError, OSError):
            job.process.join(FAREWELL)
            return Ended(f"its process ended with code {job.process.exitcode}", cancelled=job.kill_by is not None)
        if job.kill_by is not None and self._clock() > job.kill_by:
            job.process.kill()
        return None

    def _report(self, job: _Job, ended: Ended) -> None:
        path = job.order.path
        if ended.cancelled:
            log.log(NOTICE, "Export cancelled: %s was not written", path.name)
        elif isinstance(ended.error, InputError):
            log.error("%s", ended.error)
        elif ended.error:
            log.error("%s was not exported: %s", path, ended.error)
        else:
            self.written.append(path)
            log.log(NOTICE, "Exported %s", path.absolute())
