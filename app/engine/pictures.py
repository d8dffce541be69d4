"""Which exact pictures are rendered, and what share of the screen they have.

With a surface on screen (`live`) the exact engine gets a request once the state has rested, at full size and the chosen
level; its picture is faded in. Without one its pictures are what is shown while something moves: small ones, one after the
other, at most at `balanced`. A picture that a change overtakes is cancelled. Times in seconds of the clock that is given.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, replace

from avatarrex_studio.engine.engine import QUICKEST
from avatarrex_studio.engine.request import Answer, Exact, Picture, Request, Seen
from avatarrex_studio.session.notice import NOTICE
from avatarrex_studio.session.state import AUTO, IMAGE, INFLUENCE, LIVE, SLICE, OrbitView, StudioState, vector

from avatarrex.stage.stage import KeyLight

log = logging.getLogger(__name__)
REST = 0.15
"""Without a change for so long, the state rests."""
FADE = 0.2
"""From `live` to the exact picture."""
AUTO_LEVELS = ("balanced", "quality")
"""What `auto` renders at rest, one after the other."""
PATIENCE = 10.0
"""What the second of them may take; then it is cancelled, and not tried again at this size."""
MOVING_SECONDS = 0.1
"""What the pixels of a picture may take while something moves and there is no surface."""
MOVING_SHARE = (1 / 8, 1 / 4)
"""Of all pixels, whatever they take."""
KEPT = 60
"""Pictures whose times are kept."""


@dataclass(frozen=True)
class Subject:
    """What a picture shows; its level is a matter of how well."""

    figures: tuple[tuple[str, object, frozenset[str]], ...]
    """Of each the avatar, the signals in the world, and what is hidden."""
    view: OrbitView
    size: tuple[int, int]
    shows: str = IMAGE
    tool: object = None
    """The plane of a slice, or the part whose influence is shown."""
    light: KeyLight | None = None
    """That of a stage."""
    reading: int = 0
    """How often avatars were read anew by then."""

    @classmethod
    def of(cls, state: StudioState, size: tuple[int, int]) -> Subject:
        """Of `state` on a raster of `size`."""
        figures = tuple((own.avatar, own.signals, own.hidden) for own in state.each())
        shows = state.tools.shows
        tool = {SLICE: state.tools.cut, INFLUENCE: state.tools.selected}.get(shows)
        return cls(figures, state.view, size, shows, tool, state.stage.light if shows == IMAGE else None)


@dataclass(frozen=True)
class Wanted:
    """A picture that is to be rendered, is under way, or is there."""

    subject: Subject
    level: str
    dragged: bool = False


class Pictures:
    """Requests exact pictures of what a studio shows, and takes them when they come."""

    def __init__(self, exact: Exact) -> None:
        self.exact = exact
        self.picture: Picture | None = None
        """The last that came."""
        self.shown: Wanted | None = None
        """What it shows."""
        self.error: str | None = None
        """Why the present state has no picture."""
        self.history: deque[dict[str, float]] = deque(maxlen=KEPT)
        """Milliseconds per stage of the last pictures."""
        self._subject: Subject | None = None
        self._level, self._reading = AUTO, 0
        self._changed_at = -math.inf
        self._under_way: Wanted | None = None
        self._since = -math.inf
        self._failed: Wanted | None = None
        self._fade_from = -math.inf
        self._too_large = math.inf
        """Pixels of the smallest picture whose second level was cancelled."""
        self._seconds_per_pixel = math.inf
        """While something moves; unknown at first."""

    def tick(self, now: float, state: StudioState, size: tuple[int, int], live: bool, playing: bool = False) -> bool:
        """Take what came and request what is missing; whether there is another picture. `live`: a surface is on screen."""
        subject, self._level = replace(Subject.of(state, size), reading=self._reading), state.level
        if subject != self._subject:
            self._subject, self._changed_at = subject, now
        if playing:
            self._changed_at = now
        answer = self.exact.poll()
        new = self._take(now, answer, live) if answer else False
        if live and self._failed and self._failed.subject != subject:
            self.error = None
        self._request(now, state, self._wanted(now, subject, state.level, live))
        return new

    def renew(self) -> None:
        """An avatar was read anew: what is there, or under way, does not show it."""
        self._reading += 1

    def rests(self, now: float) -> bool:
        """Whether the state has not changed for a while."""
        return now - self._changed_at >= REST

    @property
    def current(self) -> bool:
        """Whether the picture shows the present state."""
        return self.shown is not None and self.shown.subject == self._subject

    @property
    def covers(self) -> bool:
        """Whether the picture belongs over a surface: it shows the present state, whose level is not the surface alone."""
        sliced = self._subject is not None and self._subject.shows == SLICE
        return self.current and (self._level != LIVE or sliced)

    def weight(self, now: float, live: bool) -> float:
        """Share of the picture over the surface, 0 to 1."""
        if not live:
            return float(self.picture is not None)
        return min(max((now - self._fade_from) / FADE, 0.0), 1.0) if self.covers else 0.0

    def point(self, x: float, y: float) -> Seen | None:
        """What is under a place of the picture, shares of its width and height; None where there is none of the present state."""
        if self.picture is None or self.shown is None or not self.current:
            return None
        depth, view = self.picture.depth, self.shown.subject.view
        height, width = depth.shape
        column, row = min(int(x * width), width - 1), min(int(y * height), height - 1)
        if depth[row, column] <= 0:
            return None
        point = view.camera(width, height).point((column + 0.5, row + 0.5), float(depth[row, column]))
        return Seen(vector(point), int(self.picture.figure[row, column]))

    def save(self, state: StudioState, size: tuple[int, int], path: str) -> None:
        """Have the state rendered and written; the console tells when it is there."""
        self.exact.request(Request(state, size, path=path))

    def _wanted(self, now: float, subject: Subject, level: str, live: bool) -> Wanted | None:
        """The next picture; None where nothing is missing."""
        if level == LIVE and (not live or subject.shows == SLICE):  # a surface has no distances
            level = QUICKEST
        if not self.rests(now):
            wanted = Wanted(subject, level if level == QUICKEST else AUTO_LEVELS[0], dragged=True)
            return None if live or wanted in (self.shown, self._failed) else wanted
        levels = {AUTO: AUTO_LEVELS, LIVE: ()}.get(level, (level,))
        there = [self.shown == Wanted(subject, name) for name in levels]
        for name in levels[there.index(True) + 1 if True in there else 0 :]:
            wanted = Wanted(subject, name)
            beyond = level == AUTO and name == AUTO_LEVELS[-1] and math.prod(subject.size) >= self._too_large
            return None if beyond or self._failed == wanted else wanted
        return None

    def _request(self, now: float, state: StudioState, wanted: Wanted | None) -> None:
        under_way = self._under_way
        if under_way and now - self._since > PATIENCE and state.level == AUTO and under_way.level == AUTO_LEVELS[-1]:
            self._too_large = math.prod(under_way.subject.size)
            self.exact.cancel()
        if wanted == under_way:
            return
        if under_way:
            if not under_way.dragged:
                self.exact.cancel()
            return
        if wanted:
            size = self._moving_size(wanted.subject.size) if wanted.dragged else wanted.subject.size
            self._under_way, self._since = wanted, now
            self.exact.request(Request(state.change(level=wanted.level), size, wanted.dragged))

    def _take(self, now: float, answer: Answer, live: bool) -> bool:
        if answer.request.path:
            if answer.error:
                log.error("%s", answer.error)
            else:
                log.log(NOTICE, "Picture written: %s", answer.request.path)
            return False
        made, self._under_way = self._under_way, None
        assert made is not None
        if answer.error:
            log.error("%s", answer.error)
            self._failed, self.error = made, answer.error
        picture = answer.picture
        if picture is None:
            return False
        self.history.append(picture.work.ms)
        if made.dragged:
            seconds = (picture.work.ms["pointmap"] + picture.work.ms["shading"]) / 1e3
            self._seconds_per_pixel = seconds / math.prod(answer.request.size)
        if live and made.subject != self._subject:
            return False
        if not self.current:
            self._fade_from = now
        self.picture, self.shown = picture, made
        self.error = self._failed = None
        return True

    def _moving_size(self, full: tuple[int, int]) -> tuple[int, int]:
        """A raster with a share of the pixels that is affordable while something moves."""
        low, high = MOVING_SHARE
        share = min(max(MOVING_SECONDS / (self._seconds_per_pixel * math.prod(full)), low), high)
        width, height = (max(16, round(side * math.sqrt(share))) for side in full)
        return width, height
