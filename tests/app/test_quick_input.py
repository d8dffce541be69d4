"""Hands that are quicker than frames, in the window: all of what GLFW calls comes between two of them, and each thing acts."""

from __future__ import annotations

import ctypes

import glfw
import pytest
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from test_fuzz_window import small_window

pytestmark = pytest.mark.window
TABS = ("Face", "Left hand", "Poses", "Body")
SLIDER = (1203.0, 444.0)
"""The third of the left shoulder, in the layout of a first start."""
KEYS = {"1": glfw.KEY_1, "J": glfw.KEY_J, "N": glfw.KEY_N, "5": glfw.KEY_5, "M": glfw.KEY_M}


def called(name, *arguments):
    """What GLFW does with an event of the window: its callback, by the window's address."""
    address = ctypes.cast(ctypes.pointer(glfw_window_hello_imgui()), ctypes.POINTER(ctypes.c_long)).contents.value
    _, callback = getattr(glfw, f"_{name}_callback_repository")[address]
    callback(None, *arguments)


def click(place):
    """Come to a place, press, let go."""
    called("cursor_pos", *place)
    called("mouse_button", glfw.MOUSE_BUTTON_LEFT, glfw.PRESS, 0)
    called("mouse_button", glfw.MOUSE_BUTTON_LEFT, glfw.RELEASE, 0)


def press(key, letter=""):
    """Press a key and let it go; its letter comes between."""
    called("key", key, 0, glfw.PRESS, 0)
    if letter:
        imgui.backends.glfw_char_callback(hello_imgui.get_glfw_window_address(), ord(letter))
    called("key", key, 0, glfw.RELEASE, 0)


def tab(title):
    """The middle of a panel's tab."""
    return imgui.internal.find_window_by_name(title).dc.dock_tab_item_rect.get_center()


def front():
    """The panel whose tab is in front of `TABS`."""
    return next(title for title in TABS if not imgui.internal.find_window_by_name(title).hidden)


def perform(window, script):
    """Open a window and go on with `script`, a generator, before each of its frames; close it where it ends."""
    from imgui_bundle import immapp

    params = window.params((1280, 800), remember=False)
    prepare, render = params.callbacks.pre_new_frame, params.callbacks.before_imgui_render

    def awake():
        """A window at rest would wait up to seven seconds for an event; these come past its queue."""
        render()
        params.fps_idling.enable_idling = False

    def step():
        prepare()
        imgui.backends.glfw_cursor_enter_callback(hello_imgui.get_glfw_window_address(), 1)
        params.app_shall_exit = next(script, True)

    params.callbacks.pre_new_frame, params.callbacks.before_imgui_render = step, awake
    immapp.run(params)


def frames(number):
    """That many frames go by."""
    yield from (False for _ in range(number))


def test_all_that_comes_between_two_frames_acts(display):
    window, seen = small_window(), {}

    def hands():
        yield from frames(14)
        click(tab("Face"))
        yield from frames(4)
        seen["tab"] = front()
        for title in ("Left hand", "Poses", "Body"):
            click(tab(title))
        seen["tabs"] = ["Face"]
        for _ in range(12):
            yield False
            seen["tabs"] += [front()] if front() not in seen["tabs"][-1:] else []
        before = window.studio.state.signals.body_pose
        called("cursor_pos", *SLIDER)
        called("mouse_button", glfw.MOUSE_BUTTON_LEFT, glfw.PRESS, 0)
        for away in range(20):
            called("cursor_pos", SLIDER[0] + away, SLIDER[1])
            yield False
        called("mouse_button", glfw.MOUSE_BUTTON_LEFT, glfw.RELEASE, 0)
        yield from frames(3)
        seen["dragged"] = abs(window.studio.state.signals.body_pose - before).max()
        done, does = [], window._run
        window._run = lambda entry: (done.append(entry.shortcut) if entry else None, does(entry))
        for key in KEYS.values():
            press(key)
        yield from frames(2 * len(KEYS))
        seen["keys"] = [name for name in done if name]
        window.studio.open_motion("walk")
        for _ in range(4):
            press(glfw.KEY_RIGHT)
        yield from frames(9)
        seen["frame"] = window.studio.state.timeline.frame
        window.palette.open()
        yield from frames(4)
        for letter in "pose squat":
            press(ord(letter.upper()), letter)
        press(glfw.KEY_BACKSPACE)
        press(ord("T"), "t")
        yield from frames(2)
        seen["letters"] = window.palette.text
        yield from frames(3)
        seen["text"] = window.palette.text
        before, done[:] = window.studio.state.signals, []
        press(glfw.KEY_ENTER)
        press(glfw.KEY_N, "n")  # in the frame in which Enter ends the text, and in the two after it
        for key in (glfw.KEY_J, glfw.KEY_M):
            yield False
            press(key, chr(key).lower())
        yield from frames(9)
        seen["posed"], seen["after Enter"] = window.studio.state.signals != before, [name for name in done if name]
        window.palette.open()
        yield from frames(4)
        press(ord("A"), "a")
        press(glfw.KEY_ESCAPE)
        press(glfw.KEY_5, "5")
        yield from frames(9)
        seen["after Esc"] = [name for name in done if name][len(seen["after Enter"]) :]

    perform(window, hands())
    assert seen["tab"] == "Face"
    assert seen["tabs"] == ["Face", "Left hand", "Poses", "Body"]
    assert seen["dragged"] > 0.1, "radians"
    assert seen["keys"] == list(KEYS)
    assert seen["frame"] == 4
    assert seen["letters"] == "pose squa", "one frame takes a whole word"
    assert seen["text"] == "pose squat"
    assert seen["posed"]
    assert seen["after Enter"] == ["N", "J", "M"]
    assert seen["after Esc"] == ["5"]
