"""Where the panels of the window are until the user moves them."""

from __future__ import annotations

from collections.abc import Callable

from imgui_bundle import hello_imgui, imgui

SPLITS = (
    ("MainDockSpace", "Right", imgui.Dir.right, 0.35),
    ("MainDockSpace", "Left", imgui.Dir.left, 0.27),
    ("MainDockSpace", "Bottom", imgui.Dir.down, 0.27),
    ("Left", "LeftMiddle", imgui.Dir.down, 0.56),
    ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.58),
)
"""Dock that is split, the new one, its side and its share."""
PLACES = {
    "Viewport": "MainDockSpace", "Body": "Right", "Left hand": "Right", "Right hand": "Right", "Face": "Right",
    "Poses": "Right", "Training": "Right", "Performance": "Right", "Camera": "Left", "Render": "LeftMiddle",
    "Scene": "LeftBottom", "Timeline": "Bottom", "Console": "Bottom",
}  # fmt: skip
"""The dock of each panel, by title."""
BARE = "Viewport"
"""The panel that begins and ends its window itself."""


def docking(panels: dict[str, Callable[[], None]]) -> hello_imgui.DockingParams:
    """What draws each of `PLACES`."""
    params = hello_imgui.DockingParams()
    params.docking_splits = [hello_imgui.DockingSplit(*split) for split in SPLITS]
    params.dockable_windows = [_window(title, dock, panels[title]) for title, dock in PLACES.items()]
    return params


def _window(title: str, dock: str, draw: Callable[[], None]) -> hello_imgui.DockableWindow:
    window = hello_imgui.DockableWindow(title, dock, draw, True, False)
    window.call_begin_end = title != BARE
    return window
