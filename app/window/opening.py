"""Anything a user opens in the window: read in a thread, then done, one after the other."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.jobs.file_kind import CAPTURE, RUN, SESSION
from avatarrex_studio.jobs.opening import Opened, read_any, read_motion
from avatarrex_studio.panels.training import TrainingPanel
from avatarrex_studio.session.commands import AddFigure, OpenAvatar, SelectFigure
from avatarrex_studio.session.figures import Place
from avatarrex_studio.session.notice import refusals_logged
from avatarrex_studio.session.recent import Recent

from avatarrex.avatar import Avatar
from avatarrex.errors import InputError
from avatarrex.signals.import_options import ImportOptions

log = logging.getLogger(__name__)
SLOW = 0.5
"""Seconds after which it is shown that something is read, with what cancels it."""


@dataclass
class Reading:
    """A path that is to be read."""

    path: str
    read: Callable[[Event], Opened]
    """Reads no avatar any more once the event is set."""
    take: Callable[[Opened], None]
    """Shows what was read."""
    slot: int | None = None
    """Of the figure that was selected when it was opened; None: of whoever is selected when it is shown."""
    places: tuple[Place, ...] = ()
    """Of all figures then: by its place a figure is found again where another one has been removed."""
    future: Future[Opened] | None = None
    since: float = field(default_factory=time.monotonic)
    cancelled: Event = field(default_factory=Event)
    again: bool = False
    """Whether it is the loaded motion, read as its user says."""


class Opening:
    """What is being opened, and the list of what was."""

    def __init__(
        self,
        studio: Studio,
        training: TrainingPanel,
        replacing: Callable[[Callable[[], None]], None] = lambda then: then(),
        deciding: Callable[[], bool] = lambda: False,
    ) -> None:
        """`replacing` is called before a session takes the place of the present one, with what shows it; `deciding` says whether
        the user has yet to answer if it does.
        """
        self.recent = Recent()
        self.arrived: Callable[[], None] = lambda: None
        """Called by the thread when something has been read."""
        self.tab = ""
        """The panel to be brought to the front."""
        self._studio, self._training, self._replacing, self._deciding = studio, training, replacing, deciding
        self._undecided = False
        """Whether a session waits to take the place of the present one: what was opened after it waits, too."""
        self._threads = ThreadPoolExecutor(1, "opening")
        self._reading: deque[Reading] = deque()

    def open(self, *paths: str) -> None:
        """Begin to open them, in this order."""
        for path in paths:
            self._begin(path, partial(self._read_any, path), self.take)

    def add(self, path: str) -> None:
        """Begin to open one; an avatar comes beside those that are there."""
        self._begin(path, partial(self._read_any, path), partial(self.take, shown=AddFigure))
        self._reading[-1].slot = None

    def motion(self, path: str) -> None:
        """Begin to read a motion file, which is then loaded."""
        self._begin(path, lambda _: read_motion(path), self.take)

    def again(self, path: str, options: ImportOptions) -> None:
        """Begin to read the loaded motion once more, guesses replaced by `options`."""
        self._begin(path, lambda _: read_motion(path, options), self._take_again)
        self._reading[-1].again = True

    def layer(self, path: str) -> None:
        """Begin to read one that comes over all layers."""
        self._begin(path, lambda _: read_motion(path), self._take_layer)

    def import_capture(self) -> None:
        """Ask for a capture of another layout, in the Training tab."""
        self.tab = "Training"
        self._training.import_capture()

    def _read_any(self, path: str, cancelled: Event) -> Opened:
        """What is at a path, in the thread. Raises `CancelledError` before an avatar that is not wanted any more."""

        def read(name: str) -> Future[Avatar]:
            if cancelled.is_set():
                raise CancelledError
            return self._studio.avatars.read(name)

        return read_any(path, read)

    def _begin(self, path: str, read: Callable[[Event], Opened], take: Callable[[Opened], None]) -> None:
        state = self._studio.state
        self._reading.append(Reading(path, read, take, state.slot, tuple(each.place for each in state.figures)))
        self._submit(self._reading[-1])

    def _submit(self, reading: Reading) -> None:
        reading.future = self._threads.submit(reading.read, reading.cancelled)
        reading.future.add_done_callback(lambda _: self.arrived())

    def cancel(self) -> None:
        """What is being read is not shown. What waits behind it is read at once, by another thread."""
        if self._reading:
            reading = self._reading.popleft()
            reading.cancelled.set()
            log.info("not opened: %s", reading.path)
            self._threads.shutdown(wait=False, cancel_futures=True)
            self._threads = ThreadPoolExecutor(1, "opening")
            self._studio.avatars.step_aside()
            for waiting in self._reading:
                waiting.since = time.monotonic()
                self._submit(waiting)

    def dropped(self, window: object, paths: Iterable[str]) -> None:
        """Files were dropped on the window: GLFW's callback."""
        self.open(*paths)

    @property
    def words(self) -> str:
        """What is under way, for the status bar; empty where nothing is."""
        if self._reading:
            return f"opening {Path(self._reading[0].path).name}…"
        return "reading the avatar…" if self._studio.avatars.reading else ""

    @property
    def busy(self) -> bool:
        """Whether something is being read."""
        return bool(self._reading)

    @property
    def rereading(self) -> bool:
        """Whether a loaded motion is read once more, or waits for it."""
        return any(reading.again for reading in self._reading)

    @property
    def slow(self) -> bool:
        """Whether that takes long enough to be shown."""
        return bool(self._reading) and not self._undecided and time.monotonic() - self._reading[0].since > SLOW

    def tend(self) -> None:
        """Do what has been read; once a frame."""
        self._undecided = self._undecided and self._deciding()
        while self._reading and not self._undecided and (future := self._reading[0].future) and future.done():
            reading = self._reading.popleft()
            try:
                with refusals_logged(opening=reading.path):
                    self._show(reading, future.result())
            except Exception:  # a fault of ours: its trace goes to the log, and the window stays as it is
                log.exception("%s could not be opened", reading.path)

    def _show(self, reading: Reading, opened: Opened) -> None:
        """Show what was read, of the figure that it was opened for; who is selected meanwhile stays so.

        Raises `InputError` where it is gone.
        """
        studio, selected = self._studio, self._studio.state.slot
        slot = selected if opened.journal or not (opened.motion or opened.avatars) else self._slot(reading)
        if slot == selected:
            reading.take(opened)
            return
        with studio.one_step():
            studio.do(SelectFigure(slot))
            reading.take(opened)
            studio.do(SelectFigure(selected))

    def _slot(self, reading: Reading) -> int:
        """Where the figure is that a path was opened for. Raises `InputError` where it is gone."""
        places = [figure.place for figure in self._studio.state.figures]
        if reading.slot is None:
            return self._studio.state.slot
        if len(places) >= len(reading.places):
            return reading.slot
        if (place := reading.places[reading.slot]) not in places:
            raise InputError(reading.path, "", "the avatar that it was opened for", "it has been removed")
        return places.index(place)

    def take(self, opened: Opened, shown: type[OpenAvatar] | type[AddFigure] = OpenAvatar) -> None:
        """Show what was read: an avatar, a session and a motion in the viewport, a capture and a run in the Training tab.

        `shown`: the command that shows an avatar.
        """
        if opened.journal:
            self._undecided = True
            self._replacing(partial(self._take, opened, shown))
        else:
            self._take(opened, shown)

    def _take(self, opened: Opened, shown: type[OpenAvatar] | type[AddFigure]) -> None:
        studio = self._studio
        if opened.journal:
            self._undecided = False
            studio.take_journal(opened.journal)
            for waiting in self._reading:  # they were opened after the session
                waiting.slot = None
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

    def _take_layer(self, opened: Opened) -> None:
        """Show a motion over all layers."""
        assert opened.motion is not None
        self._studio.take_layer(opened.motion)
        self.recent.add(opened.path)

    def _take_again(self, opened: Opened) -> None:
        """Show a motion as it is read now; where another one has been loaded meanwhile, that stays."""
        clip = self._studio.state.timeline.motion
        if clip is not None and clip.path == opened.path:
            assert opened.motion is not None
            self._studio.take_motion(opened.motion)

    def close(self) -> None:
        """Begin nothing more."""
        for reading in self._reading:
            reading.cancelled.set()
        self._threads.shutdown(wait=False, cancel_futures=True)
