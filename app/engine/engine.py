"""`Engine.render(state, size) -> Shot`: the one door between a driver (window, CLI, test, notebook) and the pipeline.

It owns the avatars and remembers each figure's previous frame, so that only what changed is computed again. An error comes back as
text beside the last good frames; nothing a user drags can end the program. No window library is imported here.
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
from avatarrex.avatar_file import avatar_stamp, load_avatar
from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.files.stamp import Stamp
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

    frames: tuple[Frame, ...]
    """Of each figure of the state, or the last good ones where `error` is set; none before the first."""
    error: str | None = None

    @property
    def frame(self) -> Frame | None:
        """That of a lone figure."""
        return self.frames[0] if self.frames else None


class Engine:
    """Renders states. `avatar` is a loaded one; without it each state's own is read by name or path.

    `settings` says how rays are cast, which pose's patches are decoded and where colours are interpolated; the rest comes from each
    state's level. Networks of avatars that it reads run on `device`. `between` is called between stages; what it raises ends the frame.
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
        self._given = avatar
        self._render = partial(render, between=between) if between else render
        self._load = partial(load, device=device)
        self._settings = settings or RenderSettings()
        self._avatars: dict[str, Avatar] = {}
        """Of the last state, by name."""
        self._stamps: dict[str, Stamp] = {}
        """Of their files when they were read."""
        self._previous: tuple[tuple[Avatar, Frame], ...] = ()
        """Of each figure."""

    def render(self, state: StudioState, size: tuple[int, int] | None = None, dragged: bool = False) -> Shot:
        """The frames of `state` at `size` (width, height), else at the state's own fixed size.

        `dragged`: the next one comes at once, and this one may interpolate colours between earlier views (`levels.moving`)
        and, at the level `fast`, be rougher and lag behind the pose (`levels.dragged`).
        Never raises for what a user can set: the error comes back as one line with the last good frames.
        """
        try:
            width, height = size or state.size.fixed or (512, 512)
            self._forget_what_changed()
            return Shot(self.frames(state, state.view.camera(width, height), dragged))
        except InputError as error:
            return Shot(self._last, str(error))
        except Exception as error:  # a fault of ours: its trace goes to the log, its line over the last good image
            log.exception("the frame could not be rendered")
            return Shot(self._last, f"{type(error).__name__}: {error}".splitlines()[0])

    @property
    def _last(self) -> tuple[Frame, ...]:
        return tuple(frame for _, frame in self._previous)

    def frames(self, state: StudioState, camera: Camera, dragged: bool = False) -> tuple[Frame, ...]:
        """A frame of each figure of `state`, in their order, through `camera`; errors are raised.

        Of each the frame before is reused, so that for a figure that stays as it is nothing is computed again.
        """
        made, each = [], state.each()
        self._avatars = {own.avatar: self._avatars[own.avatar] for own in each if own.avatar in self._avatars}
        for figure, own in enumerate(each):
            settings = self.settings(own, dragged)
            avatar = self._with_surface(own.avatar) if settings.surface else self.avatar(own.avatar)
            before, frame = self._previous[figure] if figure < len(self._previous) else (None, None)
            previous = frame if before is avatar else None
            made.append((avatar, self._render(avatar, own.signals, camera, settings, previous)))
        self._previous = tuple(made)
        return self._last

    def avatar(self, name: str) -> Avatar:
        """The avatar of that name or path, read once. Raises `InputError`."""
        if self._given is not None:
            return self._given
        if name not in self._avatars:
            self._stamps[name] = avatar_stamp(name)
            self._avatars[name] = self._load(name)
        return self._avatars[name]

    def _forget_what_changed(self) -> None:
        """Avatars whose files are others than those that were read: a training has written them anew."""
        for name in [name for name in self._avatars if avatar_stamp(name) not in ((), self._stamps[name])]:
            del self._avatars[name]

    def _with_surface(self, name: str) -> Avatar:
        """The same, read again where it had no surface and its files have changed: it may have got one meanwhile."""
        if self.avatar(name).surface is None and self._stamps.get(name) != avatar_stamp(name):
            self._avatars.pop(name, None)
        return self.avatar(name)

    def outline(self, state: StudioState) -> np.ndarray:
        """(p, 3) world metres: points of all posed bodies, for framing them. Raises `InputError`."""
        return np.concatenate(
            [Outline(self.avatar(own.avatar).person.body).points(own.signals) for own in state.each()]
        )

    def settings(self, state: StudioState, dragged: bool = False) -> RenderSettings:
        """The pipeline's settings for `state`; `auto` is the most exact level, for whoever waits for one picture."""
        chosen = levels.level(MOST_EXACT if state.level == AUTO else state.level)
        if dragged:
            chosen = levels.moving(levels.dragged(chosen) if state.level == QUICKEST else chosen)
        kept = self._settings
        chosen = replace(chosen, hidden=state.hidden, shading_tolerance=kept.shading_tolerance)
        return replace(chosen, raycast=kept.raycast, detail_from=kept.detail_from)
