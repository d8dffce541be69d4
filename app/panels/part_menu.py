"""The menu of a part of the person: pin it, reset it, turn the eyes to it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import overlay, widgets
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Command, Pin, ResetGroup
from avatarrex_studio.session.grip import LOOK, Grip, handle_of
from avatarrex_studio.session.posing import FACE_GROUPS
from avatarrex_studio.session.state import Vector, vector
from imgui_bundle import imgui

NAME = "part"


class PartMenu:
    """Opens where the mouse is."""

    def __init__(self) -> None:
        self.part: str | None = None
        self.point: Vector | None = None

    def open(self, part: str | None, point: Vector | None) -> None:
        """Open it for a part of the person, None for the background, and the surface's point there, in the frame of its place."""
        self.part, self.point = part, point
        imgui.open_popup(NAME)

    def draw(self, studio: Studio) -> Iterator[Command]:
        """Draw it where it is open; the command that was chosen."""
        if not imgui.begin_popup(NAME):
            return
        part, handle, state = self.part, handle_of(self.part), studio.state
        widgets.caption(overlay.title(part) if part else "View")
        imgui.separator()
        if handle:
            pinned = handle in state.tools.pins
            if imgui.menu_item(f"{'Unpin' if pinned else 'Pin'} the {words(handle)}", "", False)[0]:
                yield Pin((handle,), not pinned)
        if part and imgui.menu_item(f"Reset the {overlay.title(part).lower()}", "", False)[0]:
            yield from map(ResetGroup, dict.fromkeys((part, *FACE_GROUPS.get(part, ()))))
        figure = studio.figure
        camera = studio.own(vector(state.view.camera(1, 1).centre))
        for title, target in (("Look here", self.point), ("Look at the camera", camera)):
            if figure and target and imgui.menu_item(title, "", False)[0]:
                yield Grip(LOOK, figure.skeleton, state.signals).to(state, np.array(target))
        imgui.end_popup()
