"""Clicks and letters that come faster than frames, as on a slow machine: each acts, in the frames that follow.

The toolkit takes what came since the last frame in its order, and leaves the rest to the next frame where a key or button would change
twice in one, so that nothing is lost. Two things it does badly. What another thing may lie over, a tab or the head of a group, takes a press
only in the frame after the mouse has come to it: a press is sent as a finger's, which waits for that frame. And the key of a letter
that is let go ends the frame, so that a text comes by one letter a frame: letters are sent as text alone while something takes text.
"""

from __future__ import annotations

import ctypes
from functools import partial

from imgui_bundle import imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

PRINTABLE = range(32, 163)
"""GLFW's keys that give a letter, a digit or a sign."""


def open_input() -> None:
    """The window is there: its clicks and keys come through this file."""
    import glfw  # after imgui_bundle, which brings its own library

    window = glfw_window_hello_imgui()
    address = ctypes.cast(window, ctypes.c_void_p).value or 0
    glfw.set_mouse_button_callback(window, partial(_button, address))
    glfw.set_key_callback(window, partial(_key, address))


def forget_finger() -> None:
    """In each frame, before something is drawn: the mouse is a mouse. Tooltips keep away from a finger."""
    imgui.get_io().mouse_source = imgui.MouseSource.mouse


def _button(address: int, _window: object, button: int, action: int, modifiers: int) -> None:
    io = imgui.get_io()
    io.add_mouse_source_event(imgui.MouseSource.touch_screen if action else imgui.MouseSource.mouse)
    imgui.backends.glfw_mouse_button_callback(address, button, action, modifiers)
    io.add_mouse_source_event(imgui.MouseSource.mouse)


def _key(address: int, _window: object, key: int, code: int, action: int, modifiers: int) -> None:
    import glfw

    command = modifiers & (glfw.MOD_CONTROL | glfw.MOD_ALT | glfw.MOD_SUPER)
    if action and key in PRINTABLE and not command and imgui.get_io().want_text_input:
        return
    imgui.backends.glfw_key_callback(address, key, code, action, modifiers)
