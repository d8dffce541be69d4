"""The studio without its window: the journal, the engine, the resolution and the playback.

`tick` renders when something changed and says whether there is a new picture; everything a user does goes through `do`.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from avatarrex_studio.engine.auto_level import ORDER, AutoLevel, Change
from avatarrex_studio.engine.engine import Engine, Shot
from avatarrex_studio.engine.framing import framed
from avatarrex_studio.engine.resolution import Activity, Resolution
from avatarrex_studio.engine.strips import STRIP_SECONDS, Strips
from avatarrex_studio.engine.work import Work
from avatarrex_studio.session.commands import Command, SetCamera
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.playback import Playback
from avatarrex_studio.session.state import AUTO, OrbitView, StudioState
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.images import composite, write_png
from avatarrex.pipeline import Frame

log = logging.getLogger(__name__)
KEPT = 60
"""Pictures whose times are kept."""


@contextmanager
def refusals_logged() -> Iterator[None]:
    """An `InputError` ends the block and becomes a line of the console."""
    try:
        yield
    except InputError as error:
        log.error("%s", error)


class Studio:
    """An open session without its window: state, engine, playback and the picture as far as it is rendered."""

    def __init__(
        self, engine: Engine, journal: Journal | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.engine = engine
        self.journal = journal or Journal()
        self.resolution = Resolution()
        self.auto = AutoLevel()
        self.level = ORDER[0]
        """Of the last picture."""
        self.shot = Shot(None)
        self.image: Tensor | None = None
        """What is shown, premultiplied (h, w, 4): the frame's image, or the one that grows strip by strip."""
        self.work: Work | None = None
        """What the last picture cost."""
        self.history: deque[dict[str, float]] = deque(maxlen=KEPT)
        """Milliseconds per stage of the last whole pictures."""
        self.size = (0, 0)
        """Raster of the last frame."""
        self.playback = Playback()
        self._clock = clock
        self._rendered: tuple[tuple[object, ...], tuple[int, int], str] | None = None
        self._change: Change | None = None
        self._seen: tuple[object, ...] | None = None
        self._failed: tuple[object, ...] | None = None
        self._strips: Strips | None = None

    @property
    def state(self) -> StudioState:
        """The present state."""
        return self.journal.state

    def do(self, command: Command, gesture: object = None) -> None:
        """Apply a command; a value that cannot be set is said in the console and changes nothing."""
        with refusals_logged():
            self.journal.do(command, gesture)

    def undo(self) -> None:
        """Back over the last step."""
        self.playback.playing = False
        self.journal.undo()

    def redo(self) -> None:
        """Forward again."""
        self.journal.redo()

    def tick(self, viewport: tuple[int, int], pressed: bool = False) -> bool:
        """Advance the motion, render what changed; True where the picture is new.

        `pressed`: a mouse button is down, so that the picture is about to change again.
        """
        now = self._clock()
        due = self.playback.due(self.state, now)
        if due is not None:
            self.go_to(due, self.playback.gesture)
        state = self.state
        full = state.size.pixels(viewport)
        key = (state.avatar, state.signals, state.hidden, state.view, state.level, full)
        self.resolution.tick(now, key != self._seen or (pressed and self._seen is not None and self.moving))
        self._seen = key
        if key == self._failed:
            return False
        size, level = self._raster(key, full)
        dragged = self.resolution.state is not Activity.FULL
        same = (key, size, level) == self._rendered
        caught_up = same and not dragged and self.work is not None and (self.work.lags or self.work.rough)
        if same and not caught_up:
            return self._grow()
        enlarged = self._rendered is not None and self._rendered[0] == key and self.image is not None
        self._change = None if caught_up else self._what_changes(key, level)
        self._rendered, self._strips, self._failed, self.level = (key, size, level), None, None, level
        state = state.change(level=level)
        if enlarged and size[0] * size[1] * self.resolution.seconds_per_pixel > 2 * STRIP_SECONDS:
            assert self.image is not None
            cost = self.resolution.seconds_per_pixel
            self._strips = Strips(self.engine, state, size, self.image, cost, dragged)
            self.size = size
            return self._grow()
        self.shot = self.engine.render(state, size, dragged=dragged)
        if self.shot.error:
            self._failed = key
            log.error("%s", self.shot.error)
        elif self.shot.frame is not None:
            self.image, self.size, self.work = self.shot.frame.image, size, Work.of(self.shot.frame, level)
            self._measure(self.shot.frame)
            self._finished()
        return True

    def _raster(self, key: tuple[object, ...], full: tuple[int, int]) -> tuple[tuple[int, int], str]:
        """Size and level of the next picture; under `auto` the size is what the quickest level affords."""
        chosen = self.state.level
        self.resolution.at(ORDER[0] if chosen == AUTO else chosen)
        size = self.resolution.size(full)
        if chosen == AUTO:
            same = self._rendered is not None and self._rendered[0] == key
            kept = same and (self._strips is not None or self.resolution.state is Activity.MOVING)
            chosen = self.level if kept else self._best(key, size)
            self.resolution.at(chosen)
        return size, chosen

    def _best(self, key: tuple[object, ...], size: tuple[int, int]) -> str:
        change = self._what_changes(key, self.level) or Change.POSE
        return self.auto.choose(self.level, change, self.resolution.state, size[0] * size[1])

    def _what_changes(self, key: tuple[object, ...], level: str) -> Change | None:
        """What sets a picture apart from the last one; None where it is the first, or of another view and level.

        A new pose is made anew at any level: it counts as such, whatever level the picture before had.
        """
        if self._rendered is None:
            return None
        last, _, before = self._rendered
        if last[:3] != key[:3]:
            return Change.POSE
        if level == before:
            return Change.VIEW
        return Change.LEVEL if last[:4] == key[:4] else None

    def _grow(self) -> bool:
        """The next strip of a picture that is being refined."""
        if self._strips is None:
            return False
        first = self._strips.done == 0
        shot = self._strips.step()
        if shot.error:
            log.error("%s", shot.error)
            self.shot = Shot(self.shot.frame, shot.error)
            self._failed = None if self._rendered is None else self._rendered[0]
        elif shot.frame is not None:
            self.work = Work.of(shot.frame, self.level) if first or self.work is None else self.work.plus(shot.frame)
            self._measure(shot.frame)
        self.image = self._strips.image.clone()
        if self._strips.finished:
            self._strips = None
            if not shot.error:
                self._finished()
        return True

    def _measure(self, frame: Frame) -> None:
        seconds = (frame.ms["pointmap"] + frame.ms["shading"]) / 1e3
        self.resolution.measured(self._clock(), frame.image.shape[0] * frame.image.shape[1], seconds)

    def _finished(self) -> None:
        """A whole picture is there: remember what it cost."""
        assert self.work is not None
        ms = self.work.ms
        self.history.append(ms)
        if self._change is not None:
            pixels = self.size[0] * self.size[1]
            fixed, growing = ms["templates"] + ms["volume"], ms["pointmap"] + ms["shading"]
            self.auto.measured(self.level, self._change, pixels, fixed, growing)

    @property
    def moving(self) -> bool:
        """Whether the picture will still change by itself."""
        if self.playback.playing or self._strips is not None or self.resolution.wait(self._clock()) is not None:
            return True
        if self.state.level != AUTO or self._rendered is None or self._failed is not None:
            return False
        return self._best(self._rendered[0], self.size) != self.level

    def frame_person(self, viewport: tuple[int, int]) -> None:
        """The front view with the whole person in it."""
        with refusals_logged():
            view = framed(OrbitView(), self.engine.outline(self.state), self.state.size.pixels(viewport))
            self.do(SetCamera(view.azimuth, view.elevation, view.distance, view.fov, view.target))

    def open_motion(self, path: str) -> None:
        """Load a motion file and go to its first frame."""
        with refusals_logged():
            motion = self.playback.open(path)
            self.do(motion.loaded(self.state.signals))
            for note in motion.sequence.notes:
                log.info("%s: %s", Path(path).name, note)
            log.info("%s: %d frames, %g a second", Path(path).name, len(motion), motion.sequence.fps)

    def toggle_play(self) -> None:
        """Start or stop the motion."""
        self.playback.toggle(self.state, self._clock())

    def go_to(self, frame: int, gesture: object = None) -> None:
        """Go to a frame of the motion; beyond its ends to the nearest."""
        command = self.playback.at(self.state, frame)
        if command is not None:
            self.do(command, gesture)

    def step_by(self, frames: int) -> None:
        """Some frames on or back."""
        if self.state.motion:
            self.playback.playing = False
            self.go_to(self.state.motion.frame + frames)

    def save_session(self, path: str) -> None:
        """Write the journal."""
        with refusals_logged():
            self.journal.save(path)
            log.info("saved %s", path)

    def open_session(self, path: str) -> None:
        """Go on from a saved journal."""
        with refusals_logged():
            journal = Journal.load(path)
            self.engine.avatar(journal.state.avatar)  # a session without its avatar does not replace this one
            self.journal = journal
            self.playback.close()
            log.info("opened %s", path)

    def save_image(self, path: str | Path, viewport: tuple[int, int]) -> None:
        """Render the state at its full raster and write it as PNG."""
        shot = self.engine.render(self.state, self.state.size.pixels(viewport))
        if shot.error or shot.frame is None:
            log.error("no picture: %s", shot.error)
            return
        with refusals_logged():
            write_png(path, composite(shot.frame.image, self.state.background))
            log.info("wrote %s", path)
