"""A studio on the ball: exact pictures in this process, at once or when a test says so, and a surface that costs nothing."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from types import SimpleNamespace

from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.request import Answer
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.engine.worker import answered
from ball import ball_engine


class InlineExact:
    """Renders in this process, when it is polled; with `paused`, not before `paused` is taken away."""

    def __init__(self, engine=None):
        self.engine = engine or ball_engine()
        self.picture = None
        self.files = deque()
        self.dropped = deque()
        self.begun = []
        """Every request that was rendered or cancelled under way, in order."""
        self.cancelled = self.closed = self.paused = False
        self._under_way = None

    @property
    def busy(self):
        return bool(self._under_way or self.picture or self.files or self.dropped)

    def request(self, request):
        if request.path:
            self.files.append(request)
        else:
            self.picture = request
        self._begin()

    def cancel(self):
        if self.picture:
            self.dropped.append(self.picture)
            self.picture = None
        self.cancelled = self._under_way is not None and not self._under_way.path

    def poll(self):
        if self.dropped:
            return Answer(self.dropped.popleft(), cancelled=True)
        request = self._under_way
        if request is None or (self.paused and not self.cancelled):
            return None
        answer = Answer(request, cancelled=True) if self.cancelled else answered(self.engine, request)
        self._under_way, self.cancelled = None, False
        self._begin()
        return answer

    def close(self):
        self.closed = True

    def _begin(self):
        if self._under_way is not None:
            return
        if self.files:
            self._under_way = self.files.popleft()
        else:
            self._under_way, self.picture = self.picture, None
        if self._under_way:
            self.begun.append(self._under_way)


@dataclass
class FakeLive:
    """Draws a name for what it was told to draw."""

    drawn: list = field(default_factory=list)
    shadow = None
    ms = {"pose": 1.0, "draw": 2.0, "total": 3.0}  # noqa: RUF012

    def draw(self, avatar, state, size, samples=4):
        self.drawn.append((state, size))
        return SimpleNamespace(texture=f"texture {len(self.drawn)}")

    def point(self, column, row):
        return None

    def forget(self):
        pass


def ball_studio(clock, render=None, live=None, journal=None, exact=None):
    """A studio whose avatar is read when it is first looked for."""
    engine = ball_engine(render) if render else ball_engine()
    avatars = Avatars(engine.avatar)
    avatars.get("default")
    return Studio(exact or InlineExact(engine), avatars, journal, live, clock)
