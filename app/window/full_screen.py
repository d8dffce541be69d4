"""A window over the whole of its screen, and back to where it was."""

from __future__ import annotations

from typing import Any

from imgui_bundle.glfw_utils import glfw_window_hello_imgui

Box = tuple[int, int, int, int]
"""Left, top, width, height: screen coordinates."""


class FullScreen:
    """One window's."""

    def __init__(self) -> None:
        self._before: Box | None = None
        """Where the window was before it filled a screen."""

    def toggle(self) -> None:
        """Over the screen that has most of it, or back. A screen that says nothing of itself changes nothing."""
        import glfw  # after imgui_bundle, which brings its own library

        window: Any = glfw_window_hello_imgui()
        no_screen: Any = None
        if self._before and glfw.get_window_monitor(window):  # a window that was opened anew fills none
            glfw.set_window_monitor(window, no_screen, *self._before, glfw.DONT_CARE)
            return
        here = (*glfw.get_window_pos(window), *glfw.get_window_size(window))
        screens = [(_box(screen), screen) for screen in glfw.get_monitors() if glfw.get_video_mode(screen)]
        if screens:
            box, screen = max(screens, key=lambda each: _shared(here, each[0]))
            glfw.set_window_monitor(window, screen, 0, 0, *box[2:], glfw.get_video_mode(screen).refresh_rate)
            self._before = here


def _box(screen: Any) -> Box:
    import glfw

    left, top = glfw.get_monitor_pos(screen)
    size = glfw.get_video_mode(screen).size
    return left, top, size.width, size.height


def _shared(one: Box, other: Box) -> int:
    """Area of what both cover."""
    sides = (min(one[k] + one[k + 2], other[k] + other[k + 2]) - max(one[k], other[k]) for k in range(2))
    across, down = (max(side, 0) for side in sides)
    return across * down
