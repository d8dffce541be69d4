"""A window under the test engine, with patience: compiling shaders takes a minute on a busy machine."""

from __future__ import annotations

from imgui_bundle import hello_imgui, imgui
from imgui_bundle.immapp import testing

PATIENCE = 500.0
"""Seconds before the test engine gives up, the first frame included."""


def drive(window, scenario, size=(1280, 800)):
    """Open `window`, run `scenario(test)` beside it, close it."""

    def patient():
        io = imgui.test_engine.get_io(hello_imgui.get_imgui_test_engine())
        io.config_run_speed = imgui.test_engine.TestRunSpeed.fast  # the mouse is where it has to be at once
        io.config_watchdog_warning = io.config_watchdog_kill_test = PATIENCE

    params = window.params(size, remember=False)
    params.callbacks.register_tests = patient
    testing.run(test_function=scenario, runner_params=params)
