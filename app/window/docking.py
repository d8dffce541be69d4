"""Where the panels of the window are until the user moves them."""

from __future__ import annotations

from collections.abc import Callable

from imgui_bundle import hello_imgui, imgui

POSE = "Pose"
"""The layout of a first start."""
LAYOUTS: dict[str, tuple[tuple[str, str, imgui.Dir, float], ...]] = {
    POSE: (
        ("MainDockSpace", "Right", imgui.Dir.right, 0.35), ("MainDockSpace", "Left", imgui.Dir.left, 0.27),
        ("MainDockSpace", "Bottom", imgui.Dir.down, 0.27), ("Left", "LeftMiddle", imgui.Dir.down, 0.56),
        ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.58),
    ),
    "Animate": (
        ("MainDockSpace", "Bottom", imgui.Dir.down, 0.42), ("MainDockSpace", "Right", imgui.Dir.right, 0.32),
        ("MainDockSpace", "Left", imgui.Dir.left, 0.26), ("Left", "LeftMiddle", imgui.Dir.down, 0.62),
        ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.5),
    ),
    "Training": (
        ("MainDockSpace", "Right", imgui.Dir.right, 0.66), ("MainDockSpace", "Bottom", imgui.Dir.down, 0.3),
        ("MainDockSpace", "Left", imgui.Dir.down, 0.42), ("Left", "LeftMiddle", imgui.Dir.right, 0.5),
        ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.5),
    ),
}  # fmt: skip
"""Docks that are split, the new one, its side and its share, by the name of a layout."""
PLACES = {
    "Viewport": "MainDockSpace", "Body": "Right", "Left hand": "Right", "Right hand": "Right", "Face": "Right",
    "Poses": "Right", "Training": "Right", "Performance": "Right", "Camera": "Left", "Render": "LeftMiddle",
    "Scene": "LeftBottom", "Timeline": "Bottom", "Console": "Bottom",
}  # fmt: skip
"""The dock of each panel, by title."""
BARE = "Viewport"
"""The panel that begins and ends its window itself."""


def docking(panels: dict[str, Callable[[], None]]) -> list[hello_imgui.DockingParams]:
    """What draws each of `PLACES`, in each of `LAYOUTS`."""
    layouts = []
    for name, splits in LAYOUTS.items():
        params = hello_imgui.DockingParams()
        params.layout_name = name
        params.docking_splits = [hello_imgui.DockingSplit(*split) for split in splits]
        order = sorted(PLACES, key=lambda title: title != name)  # the panel of that name is the first of its tabs
        params.dockable_windows = [_window(title, PLACES[title], panels[title]) for title in order]
        layouts.append(params)
    return layouts


def toggle_panels() -> None:
    """Hide every panel but the viewport; show them where one is hidden."""
    params = hello_imgui.get_runner_params().docking_params
    others = [window for window in params.dockable_windows if window.label != BARE]
    hidden = any(not window.is_visible for window in others)
    for window in others:
        window.is_visible = hidden


def _window(title: str, dock: str, draw: Callable[[], None]) -> hello_imgui.DockableWindow:
    window = hello_imgui.DockableWindow(title, dock, draw, True, False)
    window.call_begin_end = title != BARE
    window.remember_is_visible = False
    return window
