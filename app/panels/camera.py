"""The Camera panel: named views, angles, distance and field of view."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from avatarrex_studio.panels import units, widgets
from avatarrex_studio.session.actions import Action, action
from avatarrex_studio.session.commands import Command, SetCamera
from avatarrex_studio.session.state import OrbitView, StudioState
from imgui_bundle import imgui

VIEW_BUTTONS = {
    "view.front": "Front", "view.right": "Right", "view.top": "Top", "view.back": "Back", "view.left": "Left",
    "view.home": "Person", "view.face": "Face", "view.left_hand": "L hand", "view.right_hand": "R hand",
}  # fmt: skip
"""Buttons of actions."""
ENTRIES = {
    "azimuth": ("Azimuth", (-180.0, 180.0), units.angle),
    "elevation": ("Elevation", (-89.0, 89.0), units.angle),
    "distance": ("Distance", (0.3, 8.0), units.length),
    "fov": ("View angle", (10.0, 100.0), units.angle),
}
"""Fields of the view with title, range (degrees, metres) and unit."""
LABEL = 78.0
REST = OrbitView()


def draw(state: StudioState) -> Iterator[Command | Action]:
    """Draw the panel; the commands of this frame, and the action of a view that was pressed."""
    if pressed := widgets.button_grid(VIEW_BUTTONS, 62):
        yield action(pressed)
    imgui.spacing()
    for name, (title, (low, high), unit_of) in ENTRIES.items():
        unit = unit_of()
        value, rest = (unit.factor * getattr(view, name) for view in (state.view, REST))
        widgets.label(title, LABEL)
        new = widgets.slider(f"camera.{name}", value, (unit.factor * low, unit.factor * high), unit.form, rest=rest)
        if new is not None:
            changed: dict[str, Any] = {name: min(max(new / unit.factor, low), high)}
            yield SetCamera(**changed)
    toggled, orthographic = imgui.checkbox("Orthographic", state.view.orthographic)
    widgets.tooltip("Without perspective (5): what is farther away is as large")
    if toggled:
        yield SetCamera(orthographic=orthographic)
    toggled, follow = imgui.checkbox("Follow a motion", state.view.follow)
    widgets.tooltip("The view goes along where a motion walks over the ground")
    if toggled:
        yield SetCamera(follow=follow)
