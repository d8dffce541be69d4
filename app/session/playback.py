"""Which frame of the timeline is due while it plays. Times in seconds."""

from __future__ import annotations

from avatarrex_studio.session.state import StudioState


class Playback:
    """Plays what `StudioState.played` says at the rate of the selected timeline, whatever that of the interface is."""

    def __init__(self) -> None:
        self.playing = False
        self._started = (0.0, 0)
        """The time of the start and the frame then."""
        self._plays = 0
        self._shown = -1

    @property
    def gesture(self) -> tuple[str, int]:
        """What the frames of one playback have in common: they are undone together."""
        return "play", self._plays

    def anew(self) -> tuple[str, int]:
        """What plays from here on is undone together with what is done now, and apart from what was played before."""
        self._plays += 1
        return self.gesture

    def toggle(self, state: StudioState, now: float) -> None:
        """Start, again from the first frame after the last, or stop."""
        self.playing = not self.playing
        (first, last), at = state.played, state.timeline.frame
        self._started, self._shown = (now, at if first <= at < last else first), at
        self._plays += 1

    def due(self, state: StudioState, now: float) -> int | None:
        """The frame to go to, where it is not the state's own."""
        if not self.playing:
            return None
        (first, last), timeline = state.played, state.timeline
        if timeline.frame != self._shown:  # somebody else went elsewhere
            self._started, self._shown = (now, timeline.frame), timeline.frame
        since, begun = self._started
        frame = begun + int((now - since) * timeline.fps)
        if frame > last:
            if timeline.loop:
                self._started, frame = (now, first), first
            else:
                self.playing, frame = False, last
        if frame == timeline.frame:
            return None
        self._shown = frame
        return frame
