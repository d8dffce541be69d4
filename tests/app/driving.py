"""A window under the test engine, with patience: compiling shaders takes a minute on a busy machine."""

from __future__ import annotations

import time

from imgui_bundle import hello_imgui, imgui
from imgui_bundle.immapp import testing

PATIENCE = 500.0
"""Seconds before the test engine gives up, the first frame included."""
PAUSE = 0.05
"""Seconds between frames of a window that waits: what it waits for, in another process, has the processor meanwhile."""


def drive(window, scenario, size=(1280, 800), remember=False):
    """Open `window`, run `scenario(test)` beside it, close it; `remember`: as it was left the last time."""

    def patient():
        io = imgui.test_engine.get_io(hello_imgui.get_imgui_test_engine())
        io.config_run_speed = imgui.test_engine.TestRunSpeed.fast  # the mouse is where it has to be at once
        io.config_watchdog_warning = io.config_watchdog_kill_test = PATIENCE

    params = window.params(size, remember)
    render = params.callbacks.before_imgui_render

    def awake():
        """A window at rest would wait up to seven seconds for an event; the test engine's come past its queue."""
        if render:
            render()
        params.fps_idling.enable_idling = False

    params.callbacks.before_imgui_render = awake
    params.callbacks.register_tests = patient
    testing.run(test_function=scenario, runner_params=params)


def until(test, ready, seconds=90.0):
    """Let the window draw until something is so; whether it is."""
    end = time.monotonic() + seconds
    while not ready() and time.monotonic() < end:
        time.sleep(PAUSE)
        test.yield_()
    return ready()
