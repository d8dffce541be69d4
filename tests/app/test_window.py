"""The window under Xvfb, driven like a user would: a slider moves, the picture changes, the right counters move."""

from __future__ import annotations

import logging
import time
from itertools import pairwise

import driving
import numpy as np
import pytest
import torch
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import performance
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.window import Window, start
from ball import ball_engine
from imgui_bundle import imgui

from avatarrex.avatar import Avatar
from avatarrex.pipeline import render_frame
from avatarrex.templates.person import load_person

pytestmark = pytest.mark.window


def drive(engine, scenario, size=(1280, 800)):
    """Open a window on `engine`, run `scenario(test, window)` beside it, close it."""
    window = Window(Studio(engine, Journal(start())))
    logging.getLogger().addHandler(window.console)
    try:
        driving.drive(window, lambda test: scenario(test, window), size)
    finally:
        logging.getLogger().removeHandler(window.console)
    return window


def rest(test, window, seconds=60):
    """Let the window draw until the picture is final."""
    until = time.monotonic() + seconds
    test.yield_(6)
    while window.studio.moving and time.monotonic() < until:
        test.yield_()
    assert not window.studio.moving


def test_a_slider_moves_the_picture_and_undo_brings_it_back(display):
    seen = {}

    def scenario(test, window):
        rest(test, window)
        seen["before"], seen["size"] = window.studio.image, window.studio.size
        test.window_focus("//Face")
        test.item_input_value("//Face/##jawOpen", 0.5)
        rest(test, window)
        seen["value"] = window.studio.state.signals.expression.max()
        seen["after"] = window.studio.image
        test.key_press(chord("Ctrl+Z"))
        rest(test, window)
        seen["undone"] = window.studio.image

    window = drive(ball_engine(), scenario)
    assert seen["value"] == pytest.approx(0.5)
    assert seen["before"].shape == seen["after"].shape == (*reversed(seen["size"]), 4)
    assert min(seen["size"]) > 400
    assert not torch.equal(seen["before"], seen["after"])
    assert torch.equal(seen["before"], seen["undone"])
    assert window.screen.picture.width == seen["size"][0]


def test_mouse_palette_and_keys(display):
    states = {}

    def scenario(test, window):
        rest(test, window)
        centre = test.item_info("//Viewport/picture").rect_full.get_center()
        test.mouse_move_to_pos(centre)
        test.mouse_drag_with_delta((80, -40))
        test.yield_(2)
        states["orbit"], states["steps"] = window.studio.state, len(window.studio.journal.steps)
        test.mouse_wheel_y(2.0)
        test.yield_(2)
        states["zoom"] = window.studio.state
        test.key_press(chord("1"))
        test.yield_(2)
        states["front"] = window.studio.state
        test.key_press(chord("Ctrl+P"))
        test.yield_(3)
        test.key_chars("pose squat")
        test.yield_(2)
        test.key_press(int(imgui.Key.enter))
        test.yield_(3)
        states["squat"] = window.studio.state

    drive(ball_engine(), scenario)
    assert states["orbit"].view.azimuth < -10
    assert states["orbit"].view.elevation < -5
    assert states["steps"] == 1, "a whole drag is one undo step"
    assert states["zoom"].view.distance < states["orbit"].view.distance
    assert (states["front"].view.azimuth, states["front"].view.elevation) == (0, 0)
    assert not np.array_equal(states["squat"].signals.body_pose, states["front"].signals.body_pose)


def test_the_performance_panel_changes_the_level_and_costs_nothing_when_hidden(display, monkeypatch):
    drawn, seen = [], {}
    monkeypatch.setattr(performance, "draw", lambda studio, real=performance.draw: drawn.append(studio) or real(studio))

    def scenario(test, window):
        rest(test, window)
        test.window_focus("//Face")
        test.yield_(3)
        drawn.clear()
        test.yield_(5)
        seen["hidden"], seen["pictures"] = len(drawn), len(window.studio.history)
        test.window_focus("//Performance")
        test.yield_(5)
        seen["shown"] = len(drawn)
        test.set_ref("//Performance")
        test.combo_click("##level/quality")
        rest(test, window)
        seen["level"], seen["work"] = window.studio.state.level, window.studio.work.level
        test.key_press(chord("Ctrl+Z"))
        rest(test, window)
        seen["undone"] = window.studio.work.level
        seen["image"], seen["done"] = window.studio.image, len(window.studio.history)
        test.yield_(20)
        seen["still"], seen["idle"] = window.studio.image, len(window.studio.history)

    drive(ball_engine(), scenario)
    assert seen["hidden"] == 0 < seen["shown"]
    assert seen["level"] == seen["work"] == "quality"
    assert seen["undone"] == "balanced"
    assert seen["done"] > seen["pictures"]
    assert seen["idle"] == seen["done"], "nothing changed, nothing is rendered"
    assert seen["still"] is seen["image"]


@pytest.mark.slow
def test_the_real_pipeline_in_the_window(display):
    """What a user moves is what is computed: the face, the body, rays and colour alone, or nothing at all."""
    frames, done, images = [], {}, {}

    def render(*arguments):
        frames.append(render_frame(*arguments))
        return frames[-1]

    def scenario(test, window):
        def note(name):
            rest(test, window, 240)
            done[name] = (
                {key: sum(frame.counters[key] for frame in frames) for key in frames[0].counters} if frames else {}
            )
            images[name], done[name + " notes"] = window.studio.image, window.studio.work.notes
            frames.clear()

        note("first")
        test.window_focus("//Face")
        test.item_input_value("//Face/##jawOpen", 0.8)
        note("expression")
        test.window_focus("//Body")
        test.item_input_value("//Body/##spine1.x", 12.0)
        note("body")
        test.key_press(chord("3"))
        note("camera")
        test.yield_(10)
        note("nothing")

    drive(Engine(avatar=Avatar.create(load_person("default"), "compact"), render=render), scenario, (640, 420))
    assert "OpenGL" in done["first notes"][0], "the window lends its context"
    steps = ("first", "expression", "body", "camera")
    assert all(done[name]["rays"] and done[name]["pixels_shaded"] for name in steps)
    assert not any(torch.equal(images[a], images[b]) for a, b in pairwise(steps))
    assert done["expression"]["face_evaluations"] > 0 == done["expression"]["hand_distances"]
    assert done["body"]["voxels_evaluated"] > 0 == done["body"]["hand_distances"] == done["body"]["face_evaluations"]
    still = ("voxels_evaluated", "hand_distances", "face_evaluations", "templates_posed")
    assert not any(done["camera"][key] for key in still)
    assert done["nothing"] == {}
    assert images["nothing"] is images["camera"]
