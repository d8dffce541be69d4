"""How large the window is on its screen: at its first start, and at least."""

from __future__ import annotations

from imgui_bundle.glfw_utils import glfw_window_hello_imgui

USUAL = (1440, 900)
"""Width and height at a first start, in the screen's own units, as far as the screen has room: points, of a window in which panels have
their usual widths."""
ROOMY = (1000, 640)
"""Points for panels and picture in which a layout has room: where there are less it is made as in these."""
SHARE = 0.85
"""Of the screen that a first window takes at least."""
LEAST = (640, 400)
"""Points."""


def first_size() -> tuple[int, int]:
    """Of a window at its first start, by what the screen leaves to windows; GLFW is there. Later ones are as large as the last was left."""
    room = _room()
    width, height = (max(min(usual, most), round(SHARE * most)) for usual, most in zip(USUAL, room))
    return width, height


def keep_usable(factor: float) -> None:
    """Have the system make the window no smaller than `LEAST`, of `factor` pixels each, or half of its screen."""
    import glfw  # after imgui_bundle, which brings its own library

    width, height = (min(round(factor * least), most // 2) for least, most in zip(LEAST, _room()))
    glfw.set_window_size_limits(glfw_window_hello_imgui(), width, height, glfw.DONT_CARE, glfw.DONT_CARE)


def _room() -> tuple[int, int]:
    """What the screen leaves to windows; a usual window where there is no screen that tells."""
    import glfw  # after imgui_bundle, which brings its own library

    screen = glfw.get_primary_monitor()
    if not screen:
        return USUAL
    _, _, width, height = glfw.get_monitor_workarea(screen)
    return (width, height) if width and height else USUAL
