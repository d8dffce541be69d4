"""`Engine.render(state, size) -> Shot`: the one door between a driver (window, CLI, test, notebook) and the pipeline.

It owns the avatar and remembers the previous frame, so that only what changed is computed again. An error comes back as
text beside the last good frame; nothing a user drags can end the program. No window library is imported here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from avatarrex_studio.engine.framing import Outline
from avatarrex_studio.session.state import AUTO, StudioState

from avatarrex import levels
from avatarrex.avatar import Avatar
from avatarrex.avatar_file import Stamp, avatar_stamp, load_avatar
from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.frame import Frame
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings

log = logging.getLogger(__name__)
RenderFrame = Callable[..., Frame]
QUICKEST, MOST_EXACT = "fast", "quality"
"""Levels: of what moves, and of `auto` where one picture is waited for."""


@dataclass(frozen=True)
class Shot:
    """What `Engine.render` gives back."""

    frame: Frame | None
    """The frame of the state, or the last good one where `error` is set; None before the first."""
    error: str | None = None


class Engine:
    """Renders states. `avatar` is a loaded one; without it each state's own is read by name or path.

    `settings` says how rays are cast and which pose's patches are decoded; the rest comes from each state's level. Networks of
    avatars that it reads run on `device`. `between` is called between stages; what it raises ends the frame.
    """

    def __init__(
        self,
        avatar: Avatar | None = None,
        render: RenderFrame = render_frame,
        load: Callable[..., Any] = load_avatar,
        settings: RenderSettings | None = None,
        device: str = "cpu",
        between: Callable[[], None] | None = None,
    ) -> None:
        self._avatar, self._given = avatar, avatar is not None
        self._render = partial(render, between=between) if between else render
        self._load = partial(load, device=device)
        self._settings = settings or RenderSettings()
        self._name: str | None = None
        self._stamp: Stamp = ()
        """Of the avatar's files when it was read."""
        self._previous: Frame | None = None

    def render(self, state: StudioState, size: tuple[int, int] | None = None, dragged: bool = False) -> Shot:
        """The frame of `state` at `size` (width, height), else at the state's own fixed size.

        `dragged`: the next one comes at once, and this one may interpolate colours between earlier views (`levels.moving`)
        and, at the level `fast`, be rougher and lag behind the pose (`levels.dragged`).
        Never raises for what a user can set: the error comes back as one line with the last good frame.
        """
        try:
            width, height = size or state.size.fixed or (512, 512)
            return Shot(self.frame(state, state.view.camera(width, height), dragged))
        except InputError as error:
            return Shot(self._previous, str(error))
        except Exception as error:  # a fault of ours: its trace goes to the log, its line over the last good image
            log.exception("the frame could not be rendered")
            return Shot(self._previous, f"{type(error).__name__}: {error}".splitlines()[0])

    def frame(self, state: StudioState, camera: Camera, dragged: bool = False) -> Frame:
        """The frame of `state` through `camera`; errors are raised."""
        avatar, settings = self.avatar(state.avatar), self.settings(state, dragged)
        if (
            settings.surface
            and avatar.surface is None
            and not self._given
            and self._stamp != avatar_stamp(state.avatar)
        ):
            self._name = None  # it may have got one meanwhile
            avatar = self.avatar(state.avatar)
        frame = self._render(avatar, state.signals, camera, settings, self._previous)
        self._previous = frame
        return frame

    def avatar(self, name: str) -> Avatar:
        """The avatar of that name or path, read once. Raises `InputError`."""
        if not self._given and self._name != name:
            self._stamp = avatar_stamp(name)
            self._avatar = self._load(name)
            self._name, self._previous = name, None
        assert self._avatar is not None
        return self._avatar

    def outline(self, state: StudioState) -> np.ndarray:
        """(p, 3) world metres: points of the posed body, for framing it. Raises `InputError`."""
        return Outline(self.avatar(state.avatar).person.body).points(state.signals)

    def settings(self, state: StudioState, dragged: bool = False) -> RenderSettings:
        """The pipeline's settings for `state`; `auto` is the most exact level, for whoever waits for one picture."""
        chosen = levels.level(MOST_EXACT if state.level == AUTO else state.level)
        if dragged:
            chosen = levels.moving(levels.dragged(chosen) if state.level == QUICKEST else chosen)
        kept = self._settings
        return replace(chosen, hidden=state.hidden, raycast=kept.raycast, detail_from=kept.detail_from)
