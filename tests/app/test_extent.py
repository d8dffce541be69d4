"""How large the window is, what its picture gets of it, and a display that is away for a moment."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import driving
import glfw
import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.window import extent, room, starting
from avatarrex_studio.window.docking import show_panel, toggle_panels
from avatarrex_studio.window.extent import ROOMY
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from test_fuzz_window import small_window


@pytest.mark.parametrize(
    ("screen", "size"),
    [((1280, 800), (1280, 800)), ((1366, 728), (1366, 728)), ((1920, 1040), (1632, 900)), ((2560, 1440), (2176, 1224))],
)
def test_a_first_window_suits_its_screen(monkeypatch, screen, size):
    monkeypatch.setattr(glfw, "get_primary_monitor", lambda: "screen")
    monkeypatch.setattr(glfw, "get_monitor_workarea", lambda _: (0, 0, *screen))
    assert extent.first_size() == size
    limits = []
    monkeypatch.setattr(glfw, "set_window_size_limits", lambda window, *sizes: limits.append(sizes[:2]))
    monkeypatch.setattr(extent, "glfw_window_hello_imgui", lambda: None)
    extent.keep_usable(1.25)
    assert limits == [(min(800, screen[0] // 2), min(500, screen[1] // 2))]


def test_without_a_screen_that_tells_a_window_is_as_usual(monkeypatch):
    monkeypatch.setattr(glfw, "get_primary_monitor", lambda: None)
    assert extent.first_size() == extent.USUAL


def test_a_display_that_starts_anew_is_waited_for_without_a_word(monkeypatch, capfd):
    """As Xvfb does when its last client has left."""
    answers, listener = [False, False, True, True], []
    monkeypatch.setattr(
        starting, "time", SimpleNamespace(sleep=lambda _: listener[-1](65550, b"Failed to open display"))
    )
    monkeypatch.setattr(glfw, "set_error_callback", listener.append)
    monkeypatch.setattr(glfw, "init", lambda: answers.pop(0))
    assert starting.display_fault() == ""
    assert answers == [True]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("verb", [["open"], ["runs", "."]])
def test_why_a_display_does_not_open_is_said(monkeypatch, capsys, tmp_path, verb):
    """GLFW's own words; a process of its own would say the same of a display that is not there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", ":77")
    listener = []
    monkeypatch.setattr(starting, "PAUSE", 0.0)
    monkeypatch.setattr(glfw, "set_error_callback", listener.append)
    monkeypatch.setattr(glfw, "init", lambda: listener[-1](65550, b"X11: Failed to open display :77"))
    assert main(verb) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "display: :77: expected a display that opens (or `avatarrex-studio " in line
    assert line.endswith("found X11: Failed to open display :77")


def test_a_panel_that_is_dragged_in_a_small_window_goes_the_way_of_the_mouse(monkeypatch):
    """Its own width follows, the picture has what it leaves, and others are not made wider."""

    def move(side, axis, size):
        side.size_ref = [size, 0]

    right, left = (SimpleNamespace(id_=number, size_ref=[width, 0]) for number, width in ((1, 448), (2, 225)))
    docks = {1: right, 2: left}
    monkeypatch.setattr(room, "_resize", move)  # docks of the toolkit cannot be made alone
    monkeypatch.setattr(room, "_node", docks.get)
    share, give_back = map(inspect.unwrap, (room.Room._share, room.Room._give_back))
    own, widths = room.Room(), []
    for width, moved in ((640, 0), (1280, 0), (640, 0), (640, 10), (640, -60)):
        monkeypatch.setattr(room, "_whole", lambda *_, width=width: width)
        for dragged in (moved, 0):
            own._lent = {}
            share(own, [right, left], 0)
            right.size_ref[0] += dragged
            widths.append((right.size_ref[0], left.size_ref[0]))
            give_back(own, 0)
    small, back, again, wider, _ = widths[1::2]
    narrower = widths[8]
    assert small == again
    assert back == pytest.approx((448, 225))
    assert wider[0] > again[0]
    assert sum(small) == pytest.approx(640 - 0.41 * 640)
    assert narrower == pytest.approx((wider[0] - 60, wider[1]))


def sized(test, window, width, height):
    """What the picture has in a window of another size."""
    before = window.viewport.size
    glfw.set_window_size(glfw_window_hello_imgui(), width, height)
    driving.until(test, lambda: window.viewport.size != before, 20)
    test.yield_(4)
    return window.viewport.size


@pytest.mark.window
def test_the_first_window_is_as_large_as_its_points(display, monkeypatch):
    """Where the system scales by two: seen at 192 dots an inch, it had its text over its bar."""
    monkeypatch.setattr(glfw, "get_window_content_scale", lambda window: (2.0, 2.0))
    first, seen = starting.Starting(), []
    opened = first._opened

    def look():
        places = [glfw.get_window_pos(glfw_window_hello_imgui())]
        opened()
        window = glfw_window_hello_imgui()
        seen[:] = *places, glfw.get_window_pos(window), glfw.get_window_size(window)

    first._opened = look
    first.show_while(lambda: driving.time.sleep(0.5))
    before, after, size = seen
    assert size == tuple(2 * points for points in starting.SIZE)
    assert [low - now for low, now in zip(before, after)] == [points // 2 for points in starting.SIZE]


@pytest.mark.window
def test_a_small_window_leaves_the_picture_its_share_and_gives_the_panels_theirs_back(display):
    window, seen = small_window(), {}

    def scenario(test):
        test.yield_(10)
        seen["usual"] = window.viewport.size
        seen["small"] = sized(test, window, 640, 400)
        show_panel("Face")
        test.yield_(3)
        seen["slider"] = test.item_info("//Face/##jawOpen").rect_full.get_width()
        seen["again"] = sized(test, window, 1280, 800)
        side = imgui.internal.find_window_by_name("Body").dock_node
        place = imgui.ImVec2(side.pos.x - 1, side.pos.y + 200)
        test.mouse_move_to_pos(place)
        test.mouse_drag_with_delta(imgui.ImVec2(-60, 0))
        test.yield_(3)
        seen["dragged"] = window.viewport.size
        sized(test, window, 640, 400)
        seen["dragged again"] = sized(test, window, 1280, 800)
        hello_imgui.switch_layout("Training")
        test.yield_(6)
        seen["training"] = window.viewport.size

    driving.drive(window, scenario)
    assert seen["small"][0] >= 0.4 * 640, seen["small"]
    assert seen["small"][1] >= 0.4 * 400, seen["small"]
    assert seen["slider"] > 60
    assert seen["again"] == seen["usual"]
    assert seen["dragged"][0] == pytest.approx(seen["usual"][0] - 60, abs=3)
    assert seen["dragged again"] == seen["dragged"]
    assert seen["training"][0] > 400


@pytest.mark.window
def test_what_is_kept_of_a_small_window_is_not_small(display, monkeypatch, tmp_path):
    """Another layout and back, a layout that is made in it, panels that are hidden, a program that ends in it: in a large one all are as if
    it had been so."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    windows, seen = [small_window(), small_window()], {}

    def layout(test, window, name):
        hello_imgui.switch_layout(name)
        test.yield_(6)
        return window.viewport.size

    def work(test):
        test.yield_(10)
        seen["usual"] = windows[0].viewport.size
        sized(test, windows[0], 640, 400)
        seen["made"] = layout(test, windows[0], "Animate")
        seen["made, large"] = sized(test, windows[0], 1280, 800)
        sized(test, windows[0], *ROOMY)
        windows[0]._reset_layout()
        test.yield_(6)
        seen["made in a roomy one, large"] = sized(test, windows[0], 1280, 800)
        sized(test, windows[0], 640, 400)
        seen["small"] = layout(test, windows[0], "Pose")
        for _ in range(2):  # the panels away and back
            toggle_panels()
            test.yield_(4)

    def go_on(test):
        test.yield_(10)
        seen["small again"] = windows[1].viewport.size
        seen["at the end"] = sized(test, windows[1], 1280, 800)

    for window, scenario in zip(windows, (work, go_on)):
        driving.drive(window, scenario, remember=True)
    assert seen["made"][0] >= 0.4 * 640
    assert seen["made, large"] == pytest.approx(seen["made in a roomy one, large"], abs=5)
    assert seen["small again"] == seen["small"] != seen["usual"]
    assert seen["at the end"] == pytest.approx(seen["usual"], abs=1), "whole points are kept"
