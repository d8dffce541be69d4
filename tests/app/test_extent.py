"""How large the window is, what its picture gets of it, and a display that is away for a moment."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import driving
import glfw
import pytest
from avatarrex_studio.window import extent, room, starting
from avatarrex_studio.window.docking import show_panel
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
    assert starting.reach_display()
    assert answers == [True]
    assert capfd.readouterr() == ("", "")
    monkeypatch.setattr(glfw, "init", lambda: False)
    assert not starting.reach_display()


def test_a_panel_that_is_dragged_in_a_small_window_goes_the_way_of_the_mouse(monkeypatch):
    """Its own width follows, the picture has what it leaves, and others are not made wider."""
    window = SimpleNamespace(size=[1280, 800])
    docks = SimpleNamespace(dock_node_get_root_node=lambda _: window)
    monkeypatch.setattr(room, "imgui", SimpleNamespace(internal=docks, ImVec2=lambda *size: list(size)))
    right, left = (SimpleNamespace(id_=number, size_ref=[width, 0]) for number, width in ((1, 448), (2, 225)))
    own, widths = room.Room(), []
    share = inspect.unwrap(room.Room._share)  # docks of the toolkit cannot be made alone
    for width, moved in ((640, 0), (1280, 0), (640, 0), (640, 10), (640, -60)):
        window.size[0], right.size_ref[0] = width, right.size_ref[0] + moved
        for _ in range(2):
            share(own, [right, left], 0)
        widths.append((right.size_ref[0], left.size_ref[0]))
    small, back, again, wider, narrower = widths
    assert small == again
    assert back == pytest.approx((448, 225))
    assert wider[0] > again[0]
    assert narrower == pytest.approx((wider[0] - 60, wider[1]))


@pytest.mark.window
def test_a_small_window_leaves_the_picture_its_share_and_gives_the_panels_theirs_back(display):
    window, seen = small_window(), {}

    def sized(test, width, height):
        before = window.viewport.size
        glfw.set_window_size(glfw_window_hello_imgui(), width, height)
        driving.until(test, lambda: window.viewport.size != before, 20)
        test.yield_(4)
        return window.viewport.size

    def scenario(test):
        test.yield_(10)
        seen["usual"] = window.viewport.size
        seen["small"] = sized(test, 640, 400)
        show_panel("Face")
        test.yield_(3)
        seen["slider"] = test.item_info("//Face/##jawOpen").rect_full.get_width()
        seen["again"] = sized(test, 1280, 800)
        side = imgui.internal.find_window_by_name("Body").dock_node
        place = imgui.ImVec2(side.pos.x - 1, side.pos.y + 200)
        test.mouse_move_to_pos(place)
        test.mouse_drag_with_delta(imgui.ImVec2(-60, 0))
        test.yield_(3)
        seen["dragged"] = window.viewport.size
        sized(test, 640, 400)
        seen["dragged again"] = sized(test, 1280, 800)
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
