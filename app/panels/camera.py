"""The Camera panel: named views, angles, distance and field of view."""

from __future__ import annotations

from typing import Any

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.actions import Action, action
from avatarrex_studio.session.commands import Command, SetCamera
from avatarrex_studio.session.state import OrbitView, StudioState
from imgui_bundle import imgui

VIEWS = {
    "view.front": "Front", "view.right": "Right", "view.top": "Top", "view.back": "Back", "view.left": "Left",
    "view.home": "Person", "view.face": "Face",
}  # fmt: skip
"""Buttons of actions."""
ENTRIES = {
    "azimuth": ("Azimuth", (-180.0, 180.0), "%.0f°"),
    "elevation": ("Elevation", (-89.0, 89.0), "%.0f°"),
    "distance": ("Distance", (0.3, 8.0), "%.2f m"),
    "fov": ("View angle", (10.0, 100.0), "%.0f°"),
}
"""Fields of the view with title, range and format."""
LABEL = 78.0
REST = OrbitView()


def draw(state: StudioState) -> list[Command | Action]:
    """Draw the panel; the commands of this frame, and the action of a view that was pressed."""
    commands: list[Command | Action] = []
    pressed = widgets.button_grid(VIEWS, 62)
    if pressed:
        commands.append(action(pressed))
    imgui.spacing()
    for name, (title, bounds, form) in ENTRIES.items():
        widgets.label(title, False, LABEL)
        new = widgets.slider(f"camera.{name}", getattr(state.view, name), bounds, form, rest=getattr(REST, name))
        if new is not None:
            changed: dict[str, Any] = {name: new}
            commands.append(SetCamera(**changed))
    toggled, follow = imgui.checkbox("Follow a motion over the ground", state.view.follow)
    if toggled:
        commands.append(SetCamera(follow=follow))
    return commands
