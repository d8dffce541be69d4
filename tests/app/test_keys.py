"""Keys as shortcuts: chords that are let go at once, the keypad; and what Tab, F11 and 5 do in the window."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest
from avatarrex_studio.panels.keys import chord, pressed
from avatarrex_studio.session.actions import ACTIONS
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import SizePolicy, StudioState
from avatarrex_studio.window.docking import BARE, PLACES, docking, show_panel, splits, toggle_panels
from avatarrex_studio.window.window import Window
from ball_studio import ball_studio
from driving import drive
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

CTRL, SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift


@pytest.fixture
def frame():
    """One interface frame after events (key, down); the shortcuts that were pressed in it."""
    context = imgui.create_context()
    io = imgui.get_io()
    io.display_size, io.delta_time = imgui.ImVec2(400, 300), 0.02
    io.set_ini_filename("")
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures

    def run(*events):
        for key, down in events:
            io.add_key_event(key, down)
        imgui.new_frame()
        found = {entry.shortcut for entry in ACTIONS if entry.shortcut and pressed(chord(entry.shortcut))}
        imgui.render()
        return found

    yield run
    imgui.destroy_context(context)


def test_a_modifier_that_is_let_go_in_the_same_frame_counts(frame):
    q = imgui.Key.q
    assert frame((CTRL, True)) == set()
    assert frame((q, True), (CTRL, False), (q, False)) == {"Ctrl+Q"}, "as xdotool and quick fingers send it"
    assert frame() == set()
    assert frame((imgui.Key.z, True)) == set(), "Z alone is none, and Ctrl is up"


def test_chords_are_whole_and_pressed_once(frame):
    z = imgui.Key.z
    frame((CTRL, True), (SHIFT, True))
    assert frame((z, True)) == {"Ctrl+Shift+Z"}
    assert frame() == set(), "a key that stays down is pressed once"
    assert frame((z, False), (SHIFT, False)) == set()
    frame()
    assert frame((z, True)) == {"Ctrl+Z"}
    frame((z, False), (CTRL, False))
    frame()
    assert frame((imgui.Key.p, True)) == {"P"}


@pytest.mark.parametrize("key", [imgui.Key._5, imgui.Key.keypad5])
def test_digits_of_the_keypad_are_digits(frame, key):
    assert frame((key, True)) == {"5"}


@pytest.mark.window
def test_tab_hides_the_panels_and_f11_fills_the_screen(display):
    import glfw

    window = Window(ball_studio(time.monotonic, journal=Journal(StudioState(size=SizePolicy(fixed=(64, 48))))))
    seen = {}

    def wait(test, frames=4):
        for _ in range(frames):
            test.yield_()

    def look(name):
        shown = {
            each.label for each in hello_imgui.get_runner_params().docking_params.dockable_windows if each.is_visible
        }
        seen[name] = glfw.get_window_size(glfw_window_hello_imgui()), window.viewport.size[0], shown

    def scenario(test):
        wait(test, 12)
        look("window")
        for name, key in {"bare": "Tab", "panels": "Tab", "full": "F11", "back": "F11"}.items():
            test.key_press(chord(key))
            wait(test, 20)
            look(name)
        test.key_press(chord("5"))
        wait(test)
        seen["orthographic"] = window.studio.state.view.orthographic

    drive(window, scenario, (900, 600))
    assert seen["bare"][2] == {BARE}
    assert seen["bare"][1] > 880, "the viewport has all of the width"
    assert len(seen["panels"][2]) > 10
    assert seen["panels"][1] == seen["window"][1]
    assert seen["full"][0] == (1920, 1080)
    assert seen["back"][0] == (900, 600)
    assert seen["orthographic"]


def test_full_screen_belongs_to_the_window_that_is_there(monkeypatch):
    """A window that was opened anew after its context was lost fills no screen: F11 fills it with one press."""
    import glfw
    from avatarrex_studio.window import full_screen

    fills, mode = {}, SimpleNamespace(size=SimpleNamespace(width=800, height=600), refresh_rate=60)
    said = {
        "get_window_monitor": fills.get, "get_window_pos": lambda _: (10, 20), "get_window_size": lambda _: (300, 200),
        "get_monitors": lambda: ["screen"], "get_video_mode": lambda _: mode, "get_monitor_pos": lambda _: (0, 0),
        "set_window_monitor": lambda window, monitor, *box: fills.update({window: monitor and box}),
    }  # fmt: skip
    for name, answer in said.items():
        monkeypatch.setattr(glfw, name, answer)
    whole = full_screen.FullScreen()
    for window in ("first", "anew"):
        monkeypatch.setattr(full_screen, "glfw_window_hello_imgui", lambda window=window: window)
        whole.toggle()
        assert fills[window] == (0, 0, 800, 600, 60)
    whole.toggle()
    assert fills["anew"] is None


@pytest.mark.parametrize(
    ("width", "picture"),
    [(640.0, 0.435), (1000.0, 0.435), (1100.0, 0.4545), (1440.0, 0.4745), (2048.0, 0.63), (2560.0, 0.70)],
)
def test_a_wide_window_gives_its_room_to_the_picture(width, picture):
    room = 1.0
    for split in splits("Pose", width):
        if split.initial_dock == "MainDockSpace" and split.direction in (imgui.Dir.left, imgui.Dir.right):
            room *= 1 - split.ratio
    assert room == pytest.approx(picture, abs=0.01)
    assert [split.ratio for split in splits("Training", width)] == pytest.approx([0.66, 0.3, 0.42, 0.5, 0.5])


def test_a_panel_is_shown_though_panels_are_hidden(monkeypatch):
    """*File → Import a capture…* opens the Training tab."""
    params, *_ = docking(dict.fromkeys(PLACES, lambda: None), 1440.0)
    monkeypatch.setattr(hello_imgui, "get_runner_params", lambda: SimpleNamespace(docking_params=params))
    toggle_panels()
    show_panel("Training")
    assert {window.label for window in params.dockable_windows if window.is_visible} == {BARE, "Training"}
    assert params.dockable_window_of_name("Training").focus_window_at_next_frame
