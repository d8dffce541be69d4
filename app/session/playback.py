"""The motion that the state names, and which of its frames is due while it plays. Times in seconds."""

from __future__ import annotations

import logging

from avatarrex_studio.session.commands import SetFrame
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState

from avatarrex.errors import InputError
from avatarrex.signals.import_options import ImportOptions

FBX_SECONDS = 60.0
"""The longest that the window, which stands still meanwhile, waits for Blender."""

log = logging.getLogger(__name__)


class Playback:
    """Plays one motion; the present frame belongs to the state."""

    def __init__(self) -> None:
        self.playing = False
        self.loop = True
        self._motion: Motion | None = None
        """What was read last; the state may name another."""
        self._refused: tuple[str, ImportOptions] | None = None
        """What could not be read last: it is not tried again in every frame of the window."""
        self._started = (0.0, 0)
        """The time of the start and the frame then."""
        self._plays = 0

    @property
    def gesture(self) -> tuple[str, int]:
        """What the frames of one playback have in common: they are undone together."""
        return "play", self._plays

    def take(self, motion: Motion) -> None:
        """Have a motion that was read in place of the last."""
        self._motion, self._refused, self.playing = motion, None, False

    def close(self) -> None:
        """Forget it."""
        self.playing, self._motion, self._refused = False, None, None

    def current(self, state: StudioState) -> Motion | None:
        """The motion that the state names, read again after an undo or a session that was opened.

        None without one, and where it cannot be read: that is logged once, and `toggle` tries again.
        """
        if state.motion is None:
            return None
        wanted = state.motion.path, state.motion.options
        if self._motion is not None and (self._motion.path, self._motion.imported.options) == wanted:
            return self._motion
        if wanted == self._refused:
            return None
        try:
            self._motion, self._refused = Motion.read(*wanted, FBX_SECONDS), None
        except InputError as error:
            log.error("%s", error)
            self.playing, self._refused = False, wanted
            return None
        return self._motion

    def toggle(self, state: StudioState, now: float) -> None:
        """Start, again from the first frame after the last, or stop."""
        self._refused = None
        if self.current(state) is None or state.motion is None:
            return
        self.playing = not self.playing
        at_end = state.motion.frame == state.motion.frames - 1
        self._started = (now, 0 if at_end else state.motion.frame)
        self._plays += 1

    def at(self, state: StudioState, frame: int) -> SetFrame | None:
        """The command that goes to a frame, beyond the ends to the nearest; None without a motion."""
        motion = self.current(state)
        return None if motion is None else motion.at(min(max(frame, 0), len(motion) - 1), state.signals)

    def due(self, state: StudioState, now: float) -> int | None:
        """The frame to go to, where it is not the state's own."""
        motion = self.current(state) if self.playing else None
        if motion is None:
            self.playing = False
            return None
        since, first = self._started
        frame = first + int((now - since) * motion.sequence.fps)
        if frame >= len(motion):
            if self.loop:
                self._started = (now, 0)
                frame = 0
            else:
                self.playing, frame = False, len(motion) - 1
        return frame if state.motion and frame != state.motion.frame else None
