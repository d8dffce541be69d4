"""The first window, shown at once: it says what is being prepared, while a thread imports and reads what the studio needs.

It takes no clicks, and imports neither torch nor what does.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from avatarrex_studio.panels import theme
from avatarrex_studio.window.interface_scale import InterfaceScale
from avatarrex_studio.window.runner import runner_params
from imgui_bundle import hello_imgui, imgui, immapp
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

from avatarrex.errors import InputError

Made = TypeVar("Made")
SIZE = (420, 92)
"""Points."""
FPS = 10.0
TRIES, PAUSE = 10, 0.1
"""How often a display is tried, and the seconds between."""


class Starting:
    """What the window says."""

    def __init__(self) -> None:
        self.words = "Starting…"
        self._scale = InterfaceScale()

    def say(self, words: str) -> None:
        """May be called by any thread."""
        self.words = words

    def show_while(self, prepare: Callable[[], Made]) -> Made | None:
        """What `prepare` returns, which a thread does meanwhile; None where the window was closed. Raises what `prepare` raises."""
        made: Future[Made] = Future()
        threading.Thread(target=_fulfil, args=(made, prepare), name="starting", daemon=True).start()
        immapp.run(self._params(made))
        return made.result() if made.done() else None

    def _params(self, made: Future[Made]) -> hello_imgui.RunnerParams:
        params = runner_params("AvatarReX Studio", "", SIZE, remember=False)
        geometry = params.app_window_params.window_geometry
        geometry.position_mode = hello_imgui.WindowPositionMode.monitor_center
        params.app_window_params.borderless = True
        params.app_window_params.borderless_movable = params.app_window_params.borderless_resizable = False
        params.app_window_params.borderless_closable = False
        params.imgui_window_params.default_imgui_window_type = (
            hello_imgui.DefaultImGuiWindowType.provide_full_screen_window  # text is as fine as the pixels of a window
        )
        params.imgui_window_params.background_color = theme.vec4(theme.PANEL)
        params.fps_idling.enable_idling = False
        params.fps_idling.fps_max = FPS

        def draw() -> None:
            params.app_shall_exit = made.done()
            pen, low = imgui.get_foreground_draw_list(), imgui.get_main_viewport().pos
            pen.add_text((low.x + 24, low.y + 20), theme.colour(theme.TEXT), "AvatarReX Studio")
            pen.add_text((low.x + 24, low.y + 46), theme.colour(theme.MUTED), self.words)
            share = imgui.get_time() % 1.6 / 1.6
            x = low.x + 24 + share * (SIZE[0] - 48 - 60)
            pen.add_rect_filled((x, low.y + 74), (x + 60, low.y + 77), theme.colour(theme.ACCENT), 1.5)

        params.callbacks.post_init, params.callbacks.post_new_frame = self._opened, self._scale.apply
        params.callbacks.show_gui = draw
        return params

    def _opened(self) -> None:
        """The window is there, in the middle of its screen, and stays there with as many pixels as its points need."""
        import glfw  # after imgui_bundle, which brings its own library

        self._scale.open()
        window, size = glfw_window_hello_imgui(), [round(self._scale.factor * points) for points in SIZE]
        corner = [
            low - (now - was) // 2
            for low, now, was in zip(glfw.get_window_pos(window), size, glfw.get_window_size(window))
        ]
        glfw.set_window_pos(window, *corner)
        glfw.set_window_size(window, *size)


def _fulfil(made: Future[Made], prepare: Callable[[], Made]) -> None:
    """What an executor does, in a thread that the program does not wait for when the window is closed."""
    try:
        made.set_result(prepare())
    except BaseException as error:
        made.set_exception(error)


def check_display(instead: str) -> None:
    """Raises `InputError` where no window can be opened, with the cause and what to use `instead`."""
    if cause := display_fault():
        raise InputError("display", os.environ.get("DISPLAY", ""), f"a display that opens (or `{instead}`)", cause)


def display_fault() -> str:
    """Why no display opens; empty where one does, and GLFW is there then.

    An X server without other clients starts anew when this program closes one window before it opens the next (Xvfb does), and refuses
    who comes meanwhile: it is tried again, and what GLFW says of that is not printed.
    """
    import glfw  # after imgui_bundle, which brings its own library

    said: list[Any] = [b"nothing that says why"]  # the stub has text, Python's callback gets bytes
    glfw.set_error_callback(lambda _, words: said.append(words))
    for _ in range(TRIES):
        if glfw.init():
            return ""
        time.sleep(PAUSE)
    return str(said[-1], "utf-8", "replace")
