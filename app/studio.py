"""The studio behind the window: the journal, the engine, the resolution and the playing motion. No window library here.

`tick` renders when something changed and says whether there is a new picture; everything a user does goes through `do`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.commands import Command, SetCamera
from avatarrex_studio.engine import Engine, Shot
from avatarrex_studio.framing import framed
from avatarrex_studio.journal import Journal
from avatarrex_studio.motion import Motion
from avatarrex_studio.resolution import Resolution
from avatarrex_studio.state import OrbitView, StudioState
from avatarrex_studio.strips import SECONDS, Strips
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.images import composite, write_png
from avatarrex.pipeline import Frame

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Work:
    """Times, counters and notes of a picture, be it one frame or several strips."""

    ms: dict[str, float]
    counters: dict[str, int]
    notes: tuple[str, ...]
    device: str
    """The torch device that the networks ran on."""

    @classmethod
    def of(cls, frame: Frame) -> Work:
        """One frame's."""
        return cls(frame.ms, frame.counters, frame.notes, str(frame.image.device))

    def plus(self, frame: Frame) -> Work:
        """With another strip's."""
        ms = {name: value + frame.ms[name] for name, value in self.ms.items()}
        counters = {name: count + frame.counters[name] for name, count in self.counters.items()}
        return Work(ms, counters, frame.notes, self.device)


class Studio:
    """Everything about an open session but its pixels on the screen."""

    def __init__(
        self, engine: Engine, journal: Journal | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.engine = engine
        self.journal = journal or Journal()
        self.resolution = Resolution()
        self.shot = Shot(None)
        self.image: Tensor | None = None
        """What is shown, premultiplied (h, w, 4): the frame's image, or the one that grows strip by strip."""
        self.work: Work | None = None
        """What the last picture cost."""
        self.size = (0, 0)
        """Raster of the last frame."""
        self.playing = False
        self.loop = True
        self.motion: Motion | None = None
        self._clock = clock
        self._rendered: tuple[object, ...] | None = None
        self._seen: tuple[object, ...] | None = None
        self._failed: tuple[object, ...] | None = None
        self._strips: Strips | None = None
        self._started = (0.0, 0)
        self._plays = 0

    @property
    def state(self) -> StudioState:
        """The state as it stands."""
        return self.journal.state

    def do(self, command: Command, gesture: object = None) -> None:
        """Apply a command; a value that cannot be set is said in the console and changes nothing."""
        try:
            self.journal.do(command, gesture)
        except InputError as error:
            log.error("%s", error)

    def undo(self) -> None:
        """Back over the last step."""
        self.playing = False
        self.journal.undo()

    def redo(self) -> None:
        """Forward again."""
        self.journal.redo()

    def tick(self, viewport: tuple[int, int], held: bool = False) -> bool:
        """Advance the motion, render what changed; True where the picture is new.

        `held`: a mouse button is down, so that the picture is about to change again.
        """
        now = self._clock()
        self._advance(now)
        state = self.state
        full = state.size.pixels(viewport)
        key = (state.avatar, state.signals, state.view, state.hidden, full)
        self.resolution.tick(now, key != self._seen or (held and self._seen is not None and self.moving))
        self._seen = key
        if key == self._failed:
            return False
        size = self.resolution.size(full)
        if (*key, size) == self._rendered:
            return self._grow()
        enlarged = self._rendered is not None and self._rendered[:-1] == key and self.image is not None
        self._rendered, self._strips, self._failed = (*key, size), None, None
        if enlarged and size[0] * size[1] * self.resolution.seconds_per_pixel > 2 * SECONDS:
            assert self.image is not None
            self._strips = Strips(self.engine, state, size, self.image, self.resolution.seconds_per_pixel)
            self.size = size
            return self._grow()
        self.shot = self.engine.render(state, size)
        if self.shot.error:
            self._failed = key
            log.error("%s", self.shot.error)
        elif self.shot.frame is not None:
            self.image, self.size, self.work = self.shot.frame.image, size, Work.of(self.shot.frame)
            self._measure(self.shot.frame)
        return True

    def _grow(self) -> bool:
        """The next strip of a picture that is being refined."""
        if self._strips is None:
            return False
        first = self._strips.done == 0
        shot = self._strips.step()
        if shot.error:
            log.error("%s", shot.error)
            self.shot = Shot(self.shot.frame, shot.error)
        elif shot.frame is not None:
            self.work = Work.of(shot.frame) if first or self.work is None else self.work.plus(shot.frame)
            self._measure(shot.frame)
        self.image = self._strips.image.clone()
        if self._strips.finished:
            self._strips = None
        return True

    def _measure(self, frame: Frame) -> None:
        seconds = (frame.ms["pointmap"] + frame.ms["shading"]) / 1e3
        self.resolution.measured(self._clock(), frame.image.shape[0] * frame.image.shape[1], seconds)

    @property
    def moving(self) -> bool:
        """Whether something has not come to rest yet."""
        return self.playing or self._strips is not None or self.resolution.wait(self._clock()) is not None

    def frame_person(self, viewport: tuple[int, int]) -> None:
        """The front view that holds the person as it stands."""
        try:
            view = framed(OrbitView(), self.engine.outline(self.state), self.state.size.pixels(viewport))
        except InputError as error:
            log.error("%s", error)
            return
        self.do(SetCamera(view.azimuth, view.elevation, view.distance, view.fov, view.target))

    def open_motion(self, path: str) -> None:
        """Load a motion file and stand at its first frame."""
        try:
            self.motion = Motion.read(path)
        except InputError as error:
            log.error("%s", error)
            return
        self.playing = False
        self.do(self.motion.loaded(self.state.signals))
        for note in self.motion.sequence.notes:
            log.info("%s: %s", Path(path).name, note)
        log.info("%s: %d frames, %g a second", Path(path).name, len(self.motion), self.motion.sequence.fps)

    def toggle_play(self) -> None:
        """Start or stop the motion."""
        if self._current_motion() is None or self.state.motion is None:
            return
        self.playing = not self.playing
        at_end = self.state.motion.frame == self.state.motion.frames - 1
        self._started = (self._clock(), 0 if at_end else self.state.motion.frame)
        self._plays += 1

    def go_to(self, frame: int, gesture: object = None) -> None:
        """Stand at a frame of the motion; beyond its ends at the nearest."""
        motion = self._current_motion()
        if motion is not None:
            frame = min(max(frame, 0), len(motion) - 1)
            self.do(motion.at(frame, self.state.signals), gesture)

    def step_by(self, frames: int) -> None:
        """Some frames on or back."""
        if self.state.motion:
            self.playing = False
            self.go_to(self.state.motion.frame + frames)

    def save_session(self, path: str) -> None:
        """Write the journal."""
        try:
            self.journal.save(path)
            log.info("saved %s", path)
        except InputError as error:
            log.error("%s", error)

    def open_session(self, path: str) -> None:
        """Go on from a saved journal."""
        try:
            journal = Journal.load(path)
            self.engine.avatar(journal.state.avatar)  # a session whose avatar is lost does not replace this one
        except InputError as error:
            log.error("%s", error)
            return
        self.journal = journal
        self.playing, self.motion = False, None
        log.info("opened %s", path)

    def save_image(self, path: str | Path, viewport: tuple[int, int]) -> None:
        """Render the state at its full raster and write it as PNG."""
        shot = self.engine.render(self.state, self.state.size.pixels(viewport))
        if shot.error or shot.frame is None:
            log.error("no picture: %s", shot.error)
            return
        try:
            write_png(path, composite(shot.frame.image, self.state.background))
            log.info("wrote %s", path)
        except InputError as error:
            log.error("%s", error)

    def _advance(self, now: float) -> None:
        motion = self._current_motion() if self.playing else None
        if motion is None:
            self.playing = False
            return
        since, first = self._started
        frame = first + int((now - since) * motion.sequence.fps)
        if frame >= len(motion):
            if self.loop:
                self._started = (now, 0)
                frame = 0
            else:
                self.playing, frame = False, len(motion) - 1
        if self.state.motion and frame != self.state.motion.frame:
            self.go_to(frame, ("play", self._plays))

    def _current_motion(self) -> Motion | None:
        """The motion that the state names, read again after an undo or a session that was opened."""
        if self.state.motion is None:
            return None
        if self.motion is None or self.motion.path != self.state.motion.path:
            try:
                self.motion = Motion.read(self.state.motion.path)
            except InputError as error:
                log.error("%s", error)
                self.playing = False
                return None
        return self.motion
