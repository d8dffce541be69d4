"""Clicks and letters that come faster than frames, as on a slow machine: each acts, in the frames that follow.

The toolkit takes what came since the last frame in its order, and leaves the rest to the next frame where a key or button would change
twice in one, so that nothing is lost. Three things it does badly. What another thing may lie over, a tab or the head of a group, takes a
press only in the frame after the mouse has come to it: a frame ends before each press (a finger's press would wait, too, but drags no
slider). The key of a letter that is let go ends the frame, so that a text comes by one letter a frame: letters are sent as text alone
while something takes text. And that nothing takes text any more it says in the frame after the key that ended it: what is pressed
meanwhile is made to wait.
"""

from __future__ import annotations

import ctypes

from imgui_bundle import imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

PRINTABLE = range(32, 163)
"""GLFW's keys that give a letter, a digit or a sign."""
ENDS = (257, 335, 256)
"""GLFW's Enter, that of the keypad, and Esc: they may end a text."""
PAUSE = imgui.Key.f24
"""A key that keyboards lack: pressed and let go it ends a frame."""


class QuickInput:
    """One window's."""

    def __init__(self) -> None:
        self._address = 0
        self._leaving = False
        """Whether one of `ENDS` was pressed in a text: letters are keys, too, until it is known what came of it."""

    def open(self) -> None:
        """The window is there: its clicks and keys come through this file."""
        import glfw  # after imgui_bundle, which brings its own library

        window = glfw_window_hello_imgui()
        self._address = ctypes.cast(window, ctypes.c_void_p).value or 0
        glfw.set_mouse_button_callback(window, self._button)
        glfw.set_key_callback(window, self._key)

    def begin_frame(self) -> None:
        """Before something is drawn."""
        self._leaving = self._leaving and imgui.get_current_context().input_events_queue.size() > 0

    def _button(self, _window: object, button: int, action: int, modifiers: int) -> None:
        if action:
            _end_frame()
        imgui.backends.glfw_mouse_button_callback(self._address, button, action, modifiers)

    def _key(self, _window: object, key: int, code: int, action: int, modifiers: int) -> None:
        import glfw

        typing = imgui.get_io().want_text_input
        command = modifiers & (glfw.MOD_CONTROL | glfw.MOD_ALT | glfw.MOD_SUPER)
        if action and key in PRINTABLE and not command and typing and not self._leaving:
            return
        imgui.backends.glfw_key_callback(self._address, key, code, action, modifiers)
        if action == glfw.PRESS and key in ENDS and typing:
            self._leaving = True
            imgui.backends.glfw_key_callback(self._address, key, code, glfw.RELEASE, modifiers)
            _end_frame()


def _end_frame() -> None:
    """What comes from now on waits for the next frame."""
    for down in (True, False):
        imgui.get_io().add_key_event(PAUSE, down)
