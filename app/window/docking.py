"""Where the panels of the window are until the user moves them."""

from __future__ import annotations

from collections.abc import Callable

from avatarrex_studio.window.extent import ROOMY, USUAL
from imgui_bundle import hello_imgui, imgui

POSE, TRAINING = "Pose", "Training"
"""The layout of a first start, and that of curves, which are as wide as they can be."""
WHOLE = "MainDockSpace"
NARROWEST = 215.0
"""Points that the panels at the left have at least, where there is room."""
LAYOUTS: dict[str, tuple[tuple[str, str, imgui.Dir, float], ...]] = {
    POSE: (
        (WHOLE, "Right", imgui.Dir.right, 0.35), (WHOLE, "Left", imgui.Dir.left, 0.27),
        (WHOLE, "Bottom", imgui.Dir.down, 0.27), ("Left", "LeftMiddle", imgui.Dir.down, 0.56),
        ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.58),
    ),
    "Animate": (
        (WHOLE, "Bottom", imgui.Dir.down, 0.42), (WHOLE, "Right", imgui.Dir.right, 0.32),
        (WHOLE, "Left", imgui.Dir.left, 0.26), ("Left", "LeftMiddle", imgui.Dir.down, 0.62),
        ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.5),
    ),
    TRAINING: (
        (WHOLE, "Right", imgui.Dir.right, 0.66), (WHOLE, "Bottom", imgui.Dir.down, 0.3),
        (WHOLE, "Left", imgui.Dir.down, 0.42), ("Left", "LeftMiddle", imgui.Dir.right, 0.5),
        ("LeftMiddle", "LeftBottom", imgui.Dir.down, 0.5),
    ),
}  # fmt: skip
"""Docks that are split, the new one, its side and its share, by the name of a layout."""
PLACES = {
    "Viewport": WHOLE, "Body": "Right", "Left hand": "Right", "Right hand": "Right", "Face": "Right",
    "Poses": "Right", "Training": "Right", "Camera": "Left", "Render": "LeftMiddle",
    "Scene": "LeftBottom", "Timeline": "Bottom", "Console": "Bottom", "Performance": "Bottom",
}  # fmt: skip
"""The dock of each panel, by title."""
BARE = "Viewport"
"""The panel that begins and ends its window itself."""


def docking(panels: dict[str, Callable[[], None]], width: float) -> list[hello_imgui.DockingParams]:
    """What draws each of `PLACES`, in each of `LAYOUTS`, in a window `width` points wide."""
    layouts = []
    for name in LAYOUTS:
        params = hello_imgui.DockingParams()
        params.layout_name = name
        params.docking_splits = splits(name, width)
        order = sorted(PLACES, key=lambda title: title != name)  # the panel of that name is the first of its tabs
        params.dockable_windows = [_window(title, PLACES[title], panels[title]) for title in order]
        layouts.append(params)
    return layouts


def splits(layout: str, width: float) -> list[hello_imgui.DockingSplit]:
    """How a layout is split in a window `width` points wide: panels beside the picture get no wider than in one of `USUAL` points.

    In one that is narrower than `ROOMY` shares are as in that one: room.py makes the panels so large, as far as there is room.
    """
    width = max(width, ROOMY[0])
    made, room, usual = [], width, min(width, USUAL[0])
    for dock, new, side, share in LAYOUTS[layout]:
        if layout != TRAINING and dock == WHOLE and side in (imgui.Dir.left, imgui.Dir.right):
            points = max(share * usual, NARROWEST if side == imgui.Dir.left else 0.0)
            share = points / room
            room, usual = room - points, usual - points
        made.append(hello_imgui.DockingSplit(dock, new, side, share))
    return made


def fit(width: float) -> None:
    """Have each layout made for a window `width` points wide, when it is made next."""
    params = hello_imgui.get_runner_params()
    others = list(params.alternative_docking_layouts)
    for layout in (params.docking_params, *others):
        layout.docking_splits = splits(layout.layout_name, width)
    params.alternative_docking_layouts = others


def toggle_panels() -> None:
    """Hide every panel but the viewport; show them where one is hidden."""
    params = hello_imgui.get_runner_params().docking_params
    others = [window for window in params.dockable_windows if window.label != BARE]
    hidden = any(not window.is_visible for window in others)
    for window in others:
        window.is_visible = hidden


def show_panel(title: str) -> None:
    """Bring a panel to the front, also while panels are hidden."""
    params = hello_imgui.get_runner_params().docking_params
    params.dockable_window_of_name(title).is_visible = True
    params.focus_dockable_window(title)


def docked() -> bool:
    """Whether the window that is being drawn is docked in the space of all: there the screen is cleared to the colour of panels, and
    the same once more over each of them takes 5 ms in software."""
    node = imgui.internal.get_window_dock_node()
    return node is not None and imgui.internal.dock_node_get_root_node(node).is_dock_space()


def _window(title: str, dock: str, draw: Callable[[], None]) -> hello_imgui.DockableWindow:
    def drawn() -> None:
        own = hello_imgui.get_runner_params().docking_params.dockable_window_of_name(
            title
        )  # the toolkit has its own copy
        own.imgui_window_flags = imgui.WindowFlags_.no_background if docked() else 0  # from the next frame on
        draw()

    window = hello_imgui.DockableWindow(title, dock, draw if title == BARE else drawn, True, False)
    window.call_begin_end = title != BARE
    window.remember_is_visible = False
    return window
