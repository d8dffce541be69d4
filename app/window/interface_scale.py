"""How large text, widgets and lines are: the interface is laid out in points, of which a pixel has `factor`.

The toolkit's back end takes a pixel for a point on screens whose system does not scale. Here the interface's frame gets fewer points and its
picture as many pixels for each: everything grows alike, text stays crisp, and pixels of the viewport stay pixels.
"""

from __future__ import annotations

from typing import Any

from imgui_bundle import imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

LARGE = 1400
"""Rows of pixels of a screen on which text of 15 pixels is small, where the system says nothing."""
ON_LARGE = 1.25


class InterfaceScale:
    """One window's."""

    def __init__(self) -> None:
        self.preferred = 1.0
        """What the user prefers, times what the screen needs."""
        self._screen = 1.0
        self._window: Any = None

    @property
    def factor(self) -> float:
        """Pixels of a point, beyond what the system scales by itself."""
        return self.preferred * self._screen

    def open(self) -> None:
        """See what the screen needs, and have the mouse in points. The window is there."""
        import glfw  # after imgui_bundle, which brings its own library

        window = self._window = glfw_window_hello_imgui()
        self._screen = screen_factor(window)
        glfw.set_cursor_pos_callback(window, self._mouse)
        glfw.set_window_content_scale_callback(window, lambda *_: setattr(self, "_screen", screen_factor(window)))

    def apply(self) -> None:
        """At the beginning of the interface's frame, before anything is laid out."""
        factor, io, viewport = self.factor, imgui.get_io(), imgui.get_main_viewport()
        if factor == 1.0:
            return
        io.display_size = io.display_size / factor
        io.display_framebuffer_scale = io.display_framebuffer_scale * factor
        viewport.size, viewport.work_size = viewport.size / factor, viewport.work_size / factor
        viewport.framebuffer_scale = io.display_framebuffer_scale
        if self._window and (place := _beside(self._window)):
            io.add_mouse_pos_event(place[0] / factor, place[1] / factor)

    def _mouse(self, window: object, x: float, y: float) -> None:
        imgui.get_io().add_mouse_pos_event(x / self.factor, y / self.factor)


def _beside(window: Any) -> tuple[float, float] | None:
    """Where the mouse is beside a window that has the keyboard, pixels: the toolkit's back end has just taken them for points."""
    import glfw  # after imgui_bundle, which brings its own library

    if glfw.get_window_attrib(window, glfw.HOVERED) or not glfw.get_window_attrib(window, glfw.FOCUSED):
        return None
    x, y = glfw.get_cursor_pos(window)
    return float(x), float(y)


def screen_factor(window: Any) -> float:
    """What the screen needs: the system's own factor, where that is not done by its windows already; more on a large screen without one."""
    import glfw  # after imgui_bundle, which brings its own library

    wanted, pixels, points = (
        glfw.get_window_content_scale(window)[0],
        glfw.get_framebuffer_size(window)[0],
        glfw.get_window_size(window)[0],
    )
    done = pixels / points if points else 1.0
    if wanted == done == 1.0:
        mode = glfw.get_video_mode(glfw.get_primary_monitor()) if glfw.get_primary_monitor() else None
        return ON_LARGE if mode is not None and mode.size.height >= LARGE else 1.0
    return float(max(wanted / done, 0.5))
