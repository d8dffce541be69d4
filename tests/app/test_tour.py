"""Tour, hint, dialog of preferences and the size of all, with the toolkit alone."""

from __future__ import annotations

from dataclasses import replace

import pytest
from avatarrex_studio.panels import mouse, tour, units
from avatarrex_studio.panels.preferences import PreferencesDialog
from avatarrex_studio.panels.viewport import Shown, ViewportPanel
from avatarrex_studio.session.commands import OrbitBy, PanBy, ZoomBy
from avatarrex_studio.session.preferences import Preferences
from avatarrex_studio.window.docking import PLACES
from avatarrex_studio.window.interface_scale import InterfaceScale
from imgui_bundle import imgui

MENU_BAR = "##MainMenuBar"


@pytest.fixture
def io():
    context = imgui.create_context()
    io = imgui.get_io()
    io.display_size, io.delta_time = imgui.ImVec2(800, 600), 0.1
    io.set_ini_filename("")
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
    yield io
    imgui.destroy_context(context)


def frame(draw):
    imgui.new_frame()
    answer = draw()
    imgui.render()
    return answer


def press(draw, window, button):
    """Press a button of a window, as its key would."""
    answers = [frame(draw), frame(draw)]
    identity = imgui.internal.find_window_by_name(window).get_id("##MenuBar" if window == MENU_BAR else button)
    identity = imgui.internal.im_hash_str(button, 0, identity) if window == MENU_BAR else identity
    imgui.internal.activate_item_by_id(identity)
    return [*answers, frame(draw), frame(draw)]


def test_five_steps_and_then_it_is_over(io):
    shown = tour.Tour()
    frame(shown.draw)
    assert shown.number is None
    shown.start()
    revealed, corners = [], set()
    for number in range(5):
        assert shown.number == number
        revealed.append(shown.reveal)
        frame(shown.draw)
        frame(shown.draw)
        card = imgui.internal.find_window_by_name("##tour")
        corners.add((card.pos.x, card.pos.y + card.size.y))
        press(shown.draw, "##tour", "###tour.next")
    assert shown.number is None
    assert revealed == [step.panel for step in tour.STEPS]
    assert set(revealed) <= set(PLACES)
    assert len(corners) == 1, "the buttons stay under the mouse"


def test_back_and_skip(io):
    shown = tour.Tour()
    shown.start()
    press(shown.draw, "##tour", "###tour.next")
    press(shown.draw, "##tour", "###tour.back")
    assert shown.number == 0
    press(shown.draw, "##tour", "###tour.skip")
    assert shown.number is None


def test_the_hint_goes_or_begins_the_tour(io):
    shown = tour.Tour()
    io.display_size = imgui.ImVec2(1280, 600)

    def bar():
        imgui.begin_main_menu_bar()
        wanted = tour.draw_hint(shown)
        imgui.end_main_menu_bar()
        return wanted

    assert press(bar, MENU_BAR, "###hint.close").count(False) == 1
    assert shown.number is None
    assert press(bar, MENU_BAR, "###hint.tour").count(False) == 1
    assert shown.number == 0
    io.display_size = imgui.ImVec2(60, 600)
    assert frame(bar), "without room it waits"


def test_the_dialog_changes_one_thing_at_a_time(io):
    dialog, kept = PreferencesDialog(), [Preferences()]

    def draw():
        kept.append(dialog.draw(kept[-1]))

    dialog.open()
    press(draw, "###preferences", "Maya##mouse")
    assert kept[-1] == Preferences(mouse="maya")
    press(draw, "###preferences", "Centimetres##lengths")
    assert kept[-1] == Preferences(mouse="maya", lengths="cm")


@pytest.mark.parametrize(
    ("preset", "button", "key", "command"),
    [
        ("default", 0, None, OrbitBy), ("default", 1, None, PanBy), ("default", 0, "shift", PanBy), ("blender", 2, None, OrbitBy),
        ("blender", 2, "shift", PanBy), ("blender", 2, "ctrl", ZoomBy), ("blender", 0, None, None), ("maya", 0, "alt", OrbitBy),
        ("maya", 2, "alt", PanBy), ("maya", 1, "alt", ZoomBy), ("maya", 0, None, None), ("maya", 1, None, None),
    ],
)  # fmt: skip
def test_what_a_drag_does_is_the_presets(io, studio, preset, button, key, command):
    panel, done = ViewportPanel(), []
    panel.preset = preset

    def draw():
        imgui.set_next_window_pos((0, 0))
        imgui.set_next_window_size((800, 600))
        imgui.begin("viewport", None, imgui.WindowFlags_.no_decoration)
        done.extend(panel.draw(studio, Shown(1, 800, 600)))
        imgui.end()

    if key:
        io.add_key_event(getattr(imgui.Key, f"mod_{key}"), True)
    for place, down in (((50, 500), None), ((50, 500), True), ((80, 520), None), ((90, 530), None), ((90, 530), False)):
        io.add_mouse_pos_event(*place)
        if down is not None:
            io.add_mouse_button_event(button, down)
        frame(draw)
    found = {type(each) for each in done if isinstance(each, OrbitBy | PanBy | ZoomBy)}
    assert found == ({command} if command else set())


def test_all_grows_alike(io):
    """Half the points, twice the pixels of each: what the interface lays out, and what it draws."""
    scale, seen = InterfaceScale(), {}
    scale.preferred = 2.0

    def draw():
        scale.apply()
        seen["points"] = (imgui.get_main_viewport().size.x, imgui.get_main_viewport().size.y)
        seen["io"] = (imgui.get_io().display_size.x, imgui.get_io().display_framebuffer_scale.x)
        imgui.begin("window")
        imgui.text("text")
        seen["text"] = imgui.get_font_size()
        imgui.end()

    for _ in range(2):
        io.display_size, io.display_framebuffer_scale = (
            imgui.ImVec2(800, 600),
            imgui.ImVec2(1, 1),
        )  # what a back end does
        frame(draw)
    drawn = imgui.get_draw_data()
    assert seen["points"] == (400, 300)
    assert seen["io"] == (400, 2)
    assert (drawn.display_size.x, drawn.framebuffer_scale.x) == (400, 2)
    io.display_size, io.display_framebuffer_scale, text = imgui.ImVec2(800, 600), imgui.ImVec2(1, 1), seen["text"]
    scale.preferred = 1.0
    frame(draw)
    assert seen["points"] == (800, 600)
    assert seen["text"] == text, "points of a text stay"


def test_a_camera_in_centimetres(io, studio):
    from avatarrex_studio.panels import camera

    shown = []

    def spy(label, value, speed, low, high, form, flags, real=imgui.drag_float):
        shown.append((label, form % value))
        return real(label, value, speed, low, high, form, flags)

    try:
        units.use("radians", "cm")
        imgui.drag_float, kept = spy, imgui.drag_float
        frame(lambda: (imgui.begin("camera"), list(camera.draw(studio.state)), imgui.end()))
    finally:
        units.use("degrees", "m")
        imgui.drag_float = kept
    assert ("##camera.distance", "300 cm") in shown
    assert ("##camera.fov", "0.70") in shown


def test_the_sheet_names_every_way_of_the_mouse():
    for preset in mouse.PRESETS:
        assert all(ways.endswith("drag") for ways, _ in mouse.drags(preset))
    assert replace(Preferences(), mouse="blender").mouse in mouse.PRESETS
