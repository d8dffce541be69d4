"""The Camera panel: named views, angles, distance and field of view."""

from __future__ import annotations

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.actions import Action, action
from avatarrex_studio.session.commands import Command, SetCamera
from avatarrex_studio.session.state import OrbitView, StudioState
from imgui_bundle import imgui

VIEWS = ("view.front", "view.right", "view.top", "view.back", "view.left", "view.home", "view.face")
LABEL = 78.0
REST = OrbitView()


def draw(state: StudioState) -> list[Command | Action]:
    """Draw the panel; the commands of this frame, and the action of a view that was pressed."""
    commands: list[Command | Action] = []
    titles = [
        (name, action(name).title.replace(" view", "").replace("Frame the f", "F").replace("Whole p", "P"))
        for name in VIEWS
    ]
    pressed = widgets.button_grid(titles, 62)
    if pressed:
        commands.append(action(pressed))
    imgui.spacing()
    view = state.view
    for name, low, high, form, rest in (
        ("azimuth", -180.0, 180.0, "%.0f°", REST.azimuth),
        ("elevation", -89.0, 89.0, "%.0f°", REST.elevation),
        ("distance", 0.3, 8.0, "%.2f m", REST.distance),
        ("fov", 10.0, 100.0, "%.0f°", REST.fov),
    ):
        widgets.label("View angle" if name == "fov" else name.capitalize(), False, LABEL)
        new = widgets.slider(
            f"camera.{name}", getattr(view, name), low, high, form, imgui.get_content_region_avail().x, rest
        )
        if new is not None:
            commands.append(SetCamera(**{name: new}))
    toggled, follow = imgui.checkbox("Follow a motion over the ground", view.follow)
    if toggled:
        commands.append(SetCamera(follow=follow))
    return commands
