"""Anything a user opens in the window: read in a thread, then done, one after the other."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.jobs.file_kind import CAPTURE, RUN, SESSION
from avatarrex_studio.jobs.opening import Opened, read_any
from avatarrex_studio.panels.training import TrainingPanel
from avatarrex_studio.session.commands import AddFigure, OpenAvatar
from avatarrex_studio.session.notice import refusals_logged
from avatarrex_studio.session.recent import Recent

Shown = type[OpenAvatar] | type[AddFigure]
log = logging.getLogger(__name__)


class Opening:
    """What is being opened, and the list of what was."""

    def __init__(self, studio: Studio, training: TrainingPanel) -> None:
        self.recent = Recent()
        self.arrived: Callable[[], None] = lambda: None
        """Called by the thread when something has been read."""
        self.tab = ""
        """The panel to be brought to the front."""
        self._studio, self._training = studio, training
        self._threads = ThreadPoolExecutor(1, "opening")
        self._reading: deque[tuple[str, Future[Opened], Shown]] = deque()

    def open(self, *paths: str) -> None:
        """Begin to open them, in this order."""
        for path in paths:
            self._begin(path, OpenAvatar)

    def add(self, path: str) -> None:
        """Begin to open one; an avatar comes beside those that are there."""
        self._begin(path, AddFigure)

    def _begin(self, path: str, shown: Shown) -> None:
        reading = self._threads.submit(read_any, path, self._studio.avatars.read)
        self._reading.append((path, reading, shown))
        reading.add_done_callback(lambda _: self.arrived())

    def dropped(self, window: object, paths: Iterable[str]) -> None:
        """Files were dropped on the window: GLFW's callback."""
        self.open(*paths)

    @property
    def words(self) -> str:
        """What is under way, for the status bar; empty where nothing is."""
        if self._reading:
            return f"opening {Path(self._reading[0][0]).name}…"
        return "reading the avatar…" if self._studio.avatars.reading else ""

    @property
    def busy(self) -> bool:
        """Whether something is being read."""
        return bool(self._reading)

    def tend(self) -> None:
        """Do what has been read; once a frame."""
        while self._reading and self._reading[0][1].done():
            path, reading, shown = self._reading.popleft()
            try:
                with refusals_logged(opening=path):
                    self.take(reading.result(), shown)
            except Exception:  # a fault of ours: its trace goes to the log, and the window stays as it is
                log.exception("%s could not be opened", path)

    def take(self, opened: Opened, shown: Shown = OpenAvatar) -> None:
        """Show what was read: an avatar, a session and a motion in the viewport, a capture and a run in the Training tab.

        `shown`: the command that shows an avatar.
        """
        studio = self._studio
        if opened.journal:
            studio.take_journal(opened.journal)
        for name, reading in opened.avatars.items():
            studio.avatars.keep(name, reading)
            if opened.kind != SESSION:
                studio.do(shown(name))
        if opened.motion:
            studio.take_motion(opened.motion)
        if opened.kind in (CAPTURE, RUN):
            self.tab = "Training"
        if opened.kind == CAPTURE:
            self._training.fill_in(opened.path, opened.words)
        if opened.kind == RUN:
            self._training.choose(Path(opened.path))
        log.info("opened the %s %s%s", opened.kind, opened.path, f": {opened.words}" if opened.words else "")
        self.recent.add(opened.path)

    def close(self) -> None:
        """Begin nothing more."""
        self._threads.shutdown(wait=False, cancel_futures=True)
