"""The window under Xvfb, driven like a user would: a slider moves, the picture changes, the right counters move."""

from __future__ import annotations

import ctypes
import logging
import os
import signal
import time
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import driving
import glfw
import numpy as np
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.engine.staging import in_light
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import performance, theme
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.session.commands import OrbitBy
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.screen import Screen
from avatarrex_studio.window.starting import Starting
from avatarrex_studio.window.window import IDLE_FPS, Window, start
from ball import ball_engine, render_ball
from imgui_bundle import hello_imgui, imgui
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.gl.context import current_context
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person

pytestmark = pytest.mark.window
SAMPLES = 0x80A9
"""GL_SAMPLES of the framebuffer that is drawn to."""


def compact_engine(*, between):
    """Untrained fields, through the true pipeline."""
    return Engine(avatar=Avatar.create(load_person("default"), "compact"), between=between)


def drive(make, scenario, size=(1280, 800), live=None, load=load_avatar):
    """Open a window on the engine that `make` makes in a process of its own, run `scenario(test, window)`, close it."""
    window = Window(Studio(ExactEngine(make), Avatars(load), Journal(start()), live))
    logging.getLogger().addHandler(window.console)
    try:
        driving.drive(window, lambda test: scenario(test, window), size)
    finally:
        logging.getLogger().removeHandler(window.console)
    return window


def waiting(studio):
    """Whether something is to come."""
    return studio.pictures.exact.busy or studio.avatars.reading


def rest(test, window, seconds=60):
    """Let the window draw until the picture is final."""
    test.yield_(6)
    studio = window.studio
    driving.until(test, lambda: studio.pictures.current and not studio.moving and not waiting(studio), seconds)
    assert studio.pictures.current
    assert not studio.moving
    assert not waiting(studio)


def test_a_slider_moves_the_picture_and_undo_brings_it_back(display):
    seen = {}

    def scenario(test, window):
        rest(test, window)
        seen["before"], seen["size"] = window.studio.pictures.picture.image, window.screen.shown
        test.window_focus("//Face")
        test.item_input_value("//Face/##jawOpen", 0.5)
        rest(test, window)
        seen["value"] = window.studio.state.signals.expression.max()
        seen["after"] = window.studio.pictures.picture.image
        test.key_press(chord("Ctrl+Z"))
        rest(test, window)
        seen["undone"] = window.studio.pictures.picture.image

    drive(ball_engine, scenario)
    assert seen["value"] == pytest.approx(0.5)
    assert seen["before"].shape == seen["after"].shape == (seen["size"].height, seen["size"].width, 4)
    assert min(seen["size"].width, seen["size"].height) > 400
    assert not np.array_equal(seen["before"], seen["after"])
    assert np.array_equal(seen["before"], seen["undone"])


def test_a_window_after_another_has_one_sample_a_pixel(display, monkeypatch):
    Starting().show_while(lambda: None)
    seen, idle = [], Window._idle

    def looking(window):
        found = ctypes.c_int(-1)
        kind = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.POINTER(ctypes.c_int))
        kind(glfw.get_proc_address("glGetIntegerv"))(SAMPLES, ctypes.byref(found))
        seen.append(found.value)
        idle(window)

    monkeypatch.setattr(Window, "_idle", looking)
    drive(ball_engine, rest)
    assert set(seen) == {0}, "four samples take three times as long in software"


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

    drive(ball_engine, scenario)
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
        seen["hidden"], seen["pictures"] = len(drawn), len(window.studio.pictures.history)
        test.window_focus("//Performance")
        test.yield_(5)
        seen["shown"] = len(drawn)
        test.set_ref("//Performance")
        test.combo_click("##level/quality")
        rest(test, window)
        seen["level"], seen["work"] = window.studio.state.level, window.studio.pictures.picture.work.level
        test.key_press(chord("Ctrl+Z"))
        rest(test, window)
        seen["undone"] = window.studio.pictures.picture.work.level
        seen["image"], seen["done"] = window.studio.pictures.picture.image, len(window.studio.pictures.history)
        test.yield_(20)
        seen["still"], seen["idle"] = window.studio.pictures.picture.image, len(window.studio.pictures.history)
        idling, idle = hello_imgui.get_runner_params().fps_idling, window._idle
        window._idle = lambda: (idle(), seen.update(waits=idling.enable_idling))  # which `driving` takes back
        test.yield_(2)
        seen["rate"] = idling.fps_idle

    drive(ball_engine, scenario)
    assert seen["hidden"] == 0 < seen["shown"]
    assert seen["level"] == seen["work"] == "quality"
    assert seen["undone"] == "balanced"
    assert seen["done"] > seen["pictures"]
    assert seen["idle"] == seen["done"], "nothing changed, nothing is rendered"
    assert seen["still"] is seen["image"]
    assert seen["waits"]
    assert seen["rate"] == pytest.approx(IDLE_FPS)


def slow_ball(avatar, signals, camera, settings, previous=None, between=None):
    """A ball that takes a second, in a hundred stages."""
    for _ in range(100):
        between()
        time.sleep(0.01)
    return render_ball(avatar, signals, camera, settings, previous)


def slow_engine(*, between):
    return ball_engine(slow_ball, between=between)


def surfaced(name):
    """Untrained fields with the template as their surface."""
    avatar = Avatar.create(load_person("default"), "compact")
    avatar.surface = template_surface()
    return avatar


def test_the_level_live_shows_the_surface_alone(display, monkeypatch):
    """The texture that is shown is read back by the thread that drew it."""
    seen, shown = {}, {}

    def read(screen, studio, new, show=Screen.show):
        show(screen, studio, new)
        if new and screen.shown:
            texture = screen.context.external_texture(
                screen.shown.texture, (screen.shown.width, screen.shown.height), 4, 0, "f1"
            )
            shown["image"] = np.frombuffer(texture.read(), np.uint8).reshape(-1, 4)

    def scenario(test, window):
        rest(test, window)
        seen["exact"] = shown["image"]
        test.window_focus("//Performance")
        test.set_ref("//Performance")
        test.combo_click("##level/live")
        test.yield_(10)
        studio = window.studio
        seen["live"], seen["stages"] = shown["image"], set(studio.live.ms)
        seen["now"] = (studio.moving, waiting(studio), studio.pictures.error)
        test.key_press(chord("Ctrl+Z"))
        rest(test, window)
        seen["undone"] = shown["image"]

    monkeypatch.setattr(Screen, "show", read)
    drive(ball_engine, scenario, live=LiveSurface(), load=surfaced)
    assert not np.array_equal(seen["exact"], seen["live"])
    assert np.array_equal(seen["exact"], seen["undone"])
    assert len(np.unique(seen["live"], axis=0)) > 50, "more than a background"
    assert seen["stages"] == {"surface", "raster", "total"}
    assert seen["now"] == (False, False, None)


class PlainSurface:
    """A surface of one colour that follows the view."""

    shadow = None
    ms = {"pose": 0.0, "draw": 0.0, "total": 0.0}  # noqa: RUF012

    def __init__(self):
        self.states, self.kept = [], {}

    def draw(self, avatar, state, size, samples=4):
        self.states.append(state)
        with current_context() as context:
            shade = round(state.view.azimuth) % 200
            self.kept[size] = context.texture(size, 4, bytes([shade, 40, 60, 255]) * (size[0] * size[1]))
        return SimpleNamespace(texture=self.kept[size])

    def point(self, column, row):
        return None

    def forget(self):
        self.kept.clear()


def test_the_interface_does_not_wait_for_the_engine(display, tmp_path, caplog):
    """A drag, a playback and a screenshot beside an engine that takes a second; then it is killed."""
    write_json(tmp_path / "turn.json", SignalSequence(tuple(
        Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(60)), 30.0, "turn"))  # fmt: skip
    caplog.set_level(logging.INFO)
    surface, seen, ends = PlainSurface(), {}, []

    def scenario(test, window):
        studio = window.studio
        rest(test, window)
        seen["fade"] = studio.weight
        pictures = len(studio.pictures.history)
        centre = test.item_info("//Viewport/picture").rect_full.get_center()
        test.mouse_move_to_pos(centre)
        drawn = len(surface.states)
        test.mouse_down()
        for k in range(8):
            test.mouse_teleport_to_pos(imgui.ImVec2(centre.x + 10 * k, centre.y - 5 * k))
            test.yield_()
        test.mouse_up()
        test.yield_(2)
        seen["drag"], seen["dragged"] = len(surface.states) - drawn, len(studio.pictures.history) - pictures
        seen["weight"], seen["now"] = studio.weight, surface.states[-1].view == studio.state.view
        studio.open_motion(str(tmp_path / "turn.json"))
        test.key_press(chord("Space"))
        drawn, until = len(surface.states), time.monotonic() + 2
        while time.monotonic() < until:
            test.yield_()
        test.key_press(chord("Space"))
        seen["played"] = len(surface.states) - drawn
        start = len(ends)
        studio.save_image(tmp_path / "a.png", (32, 24))
        while not (tmp_path / "a.png").exists() and len(ends) < start + 2000:
            test.yield_()
        seen["frames beside the file"] = len(ends) - start
        rest(test, window)
        os.kill(studio.pictures.exact.process, signal.SIGKILL)
        test.yield_(20)
        test.key_press(chord("3"))
        rest(test, window)
        seen["end"] = studio.weight

    window = Window(Studio(ExactEngine(slow_engine), Avatars(), Journal(start()), surface))
    ticked = window.studio.tick
    window.studio.tick = lambda viewport: (ended(ends), ticked(viewport))[1]
    logging.getLogger().addHandler(window.console)
    try:
        driving.drive(window, lambda test: scenario(test, window))
    finally:
        logging.getLogger().removeHandler(window.console)
    assert seen["fade"] == seen["end"] == 1
    assert seen["drag"] > 3
    assert seen["dragged"] == 0
    assert seen["weight"] == 0
    assert seen["now"], "the surface shows the newest state"
    assert seen["played"] > 10, "an interface that waits for the engine shows two"
    assert seen["frames beside the file"] > 10
    assert (tmp_path / "a.png").stat().st_size > 100
    lines = "\n".join(line for _, line in window.console.lines)
    assert "killed by SIGKILL" in lines
    assert "Picture written" in lines
    assert not Path(f"/proc/{window.studio.pictures.exact.process}").exists(), "closing the window ends the engine"


def ended(ends):
    """Note that an interface frame has begun."""
    ends.append(time.monotonic())


@pytest.mark.slow
def test_the_real_pipeline_in_the_window(display, tmp_path):
    """What a user moves is what is computed, face, body, rays alone or nothing; the saved session gives the same frame."""
    done, images = {}, {}

    def scenario(test, window):
        works = []
        take = window.studio.pictures._take

        def taken(now, answer, live):
            works.extend([answer.picture.work] if answer.picture else [])
            return take(now, answer, live)

        window.studio.pictures._take = taken

        def note(name):
            rest(test, window, 240)
            done[name] = {key: sum(work.counters[key] for work in works) for key in works[0].counters} if works else {}
            images[name], done[name + " notes"] = (
                window.studio.pictures.picture.image,
                window.studio.pictures.picture.work.notes,
            )
            works.clear()

        window.studio.do(OrbitBy(0.5, 0.0))
        note("first")
        test.window_focus("//Face")
        test.item_input_value("//Face/##jawOpen", 0.8)
        note("expression")
        test.window_focus("//Body")
        test.item_input_value("//Body/##spine1.x", 12.0)
        note("body")
        test.key_press(chord("3"))
        note("camera")
        window.studio.journal.save(tmp_path / "session.json")
        test.yield_(10)
        note("nothing")

    drive(compact_engine, scenario, (640, 420))
    assert "OpenGL" in done["first notes"][0], "the engine has a context of its own"
    steps = ("first", "expression", "body", "camera")
    assert all(done[name]["rays"] and done[name]["pixels_shaded"] for name in steps)
    assert not any(np.array_equal(images[a], images[b]) for a, b in pairwise(steps))
    assert done["expression"]["face_evaluations"] > 0 == done["expression"]["hand_distances"]
    assert done["body"]["voxels_evaluated"] > 0 == done["body"]["hand_distances"] == done["body"]["face_evaluations"]
    still = ("voxels_evaluated", "hand_distances", "face_evaluations", "templates_posed")
    assert not any(done["camera"][key] for key in still)
    assert done["nothing"] == {}
    assert images["nothing"] is images["camera"]
    state, shown = Journal.load(tmp_path / "session.json").state, images["camera"]
    frames = compact_engine(between=None).frames(state, state.view.camera(shown.shape[1], shown.shape[0]))
    again = in_light(frames, state).image
    np.testing.assert_allclose(255 * again.numpy().clip(0, 1), shown, atol=1.0)


def test_a_docked_panel_has_no_ground_of_its_own_and_a_floating_one_has(display):
    """The screen is cleared to the colour of panels."""
    flags = {}

    def own():
        params = hello_imgui.get_runner_params()
        return params.docking_params.dockable_window_of_name("Body").imgui_window_flags

    def scenario(test, window):
        test.yield_(6)
        test.window_focus("//Body")
        test.yield_(3)
        flags["docked"] = own()
        flags["clear"] = tuple(hello_imgui.get_runner_params().imgui_window_params.background_color)
        test.undock_window("//Body")
        test.yield_(3)
        flags["floating"] = own()

    drive(ball_engine, scenario)
    assert flags["docked"] == imgui.WindowFlags_.no_background
    assert flags["floating"] == 0
    assert flags["clear"] == pytest.approx((*theme.shade(theme.PANEL), 1.0), abs=1e-6)
