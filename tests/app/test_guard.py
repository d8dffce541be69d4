"""What fails in a panel or a command becomes text with its cause; the interface's frame goes on."""

from __future__ import annotations

import logging
from types import SimpleNamespace

import pytest
from avatarrex_studio.window.guard import Failure, Guard
from avatarrex_studio.window.window import Window
from imgui_bundle import imgui, implot

from avatarrex.errors import InputError


@pytest.fixture
def frame():
    """One interface frame that must end without an error of the toolkit."""
    context = imgui.create_context()
    io = imgui.get_io()
    io.display_size, io.delta_time = imgui.ImVec2(400, 300), 0.1
    io.set_ini_filename("")
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures

    def run(draw):
        imgui.new_frame()
        imgui.begin("panel")
        draw()
        imgui.end()
        imgui.render()

    yield run
    imgui.destroy_context(context)


def broken():
    """Fails with everything open."""
    imgui.begin("inner")
    imgui.push_style_var(imgui.StyleVar_.alpha, 0.5)
    imgui.begin_child("child")
    imgui.begin_table("table", 2)
    imgui.push_id("id")
    imgui.begin_disabled()
    raise ValueError("seven")


def test_what_was_begun_is_ended(frame):
    told = []
    guard = Guard(told.append)
    seen = {}

    def draw():
        seen["answer"] = guard.run("A panel", broken)
        seen["window"], seen["alpha"] = imgui.internal.get_current_window().name, imgui.get_style().alpha
        imgui.text("goes on")

    frame(draw)
    frame(draw)
    assert seen == {"answer": None, "window": "panel", "alpha": 1.0}
    assert len(told) == 1, "once for each cause"
    assert told[0].place == "A panel"
    assert told[0].cause == "ValueError: seven"
    assert "begin_disabled" not in told[0].cause
    assert "in broken" in told[0].details, "the trace is there to be copied"
    assert "Ctrl+S" in told[0].text


def test_a_plot_that_was_begun_does_not_break_the_next(frame):
    def plotting():
        if implot.get_current_context() is None:
            implot.create_context()
        implot.begin_plot("plot")
        raise ValueError("seven")

    guard = Guard(lambda failure: None)
    frame(lambda: guard.run("Plots", plotting))

    def plots():
        implot.create_context()
        assert implot.begin_plot("plot")
        implot.end_plot()
        implot.destroy_context()

    frame(plots)


def test_a_panel_that_failed_waits_for_another_try(frame):
    guard, calls = Guard(lambda failure: None), []

    def draw():
        calls.append(1)
        raise ValueError("seven")

    for _ in range(3):
        frame(lambda: guard.panel("Face", draw))
    assert len(calls) == 1
    del guard.failed["Face"]
    frame(lambda: guard.panel("Face", draw))
    assert len(calls) == 2


def test_refused_input_is_no_fault(frame, caplog):
    told, guard = [], None
    guard = Guard(told.append)

    def refused():
        raise InputError("walk.bvh", "", "a motion", "nothing")

    with caplog.at_level(logging.ERROR):
        frame(lambda: guard.run("Opening", refused))
    assert told == []
    assert "walk.bvh" in caplog.text


def test_a_fault_that_is_worded_otherwise_each_time_is_told_once(frame):
    told, calls = [], []
    guard = Guard(told.append)

    def draw():
        calls.append(1)
        raise ValueError(f"at frame {len(calls)}")

    for _ in range(5):
        frame(lambda: guard.run("The picture", draw))
    assert (len(calls), len(told)) == (5, 1)
    assert guard.failed["The picture"].cause == "ValueError: at frame 5"


def test_what_lies_over_the_panels_fails_alone(frame):
    """A page that fails leaves the questions, among them the one that tells of it, and the keys."""
    done, told = [], []

    def page(name):
        return SimpleNamespace(draw=lambda *_: done.append(name))

    window = SimpleNamespace(
        guard=Guard(told.append), palette=SimpleNamespace(draw=lambda journal: broken()), studio=SimpleNamespace(journal=None),
        files=page("files"), timeline=SimpleNamespace(reading=page("reading")), available=SimpleNamespace(draw=broken),
        questions=page("questions"), personal=page("personal"), _toasts=lambda: done.append("toasts"),
        _shortcuts=lambda: done.append("keys"), _run=lambda entry: None,
    )  # fmt: skip
    frame(lambda: Window._over(window))
    assert done == ["files", "reading", "questions", "personal", "toasts", "keys"]
    assert [failure.place for failure in told] == ["Commands", "What is available"]


def test_autosave_goes_on_where_the_picture_fails(frame):
    done, told = [], []
    window = SimpleNamespace(
        guard=Guard(told.append), _frames=100, _picture=broken, _idle=lambda: done.append("idle"),
        studio=SimpleNamespace(journal=None, state=SimpleNamespace(avatar="default"), avatars=SimpleNamespace(ready=lambda name: None)),
        loss=SimpleNamespace(found=lambda drawn: done.append(drawn)), face=SimpleNamespace(follow=lambda avatar: done.append("face")),
        _own_surfaces=lambda: done.append("surface"), _open_what_was_read=lambda: done.append("opening"),
        autosave=SimpleNamespace(tend=lambda journal: done.append("autosave")), _room=SimpleNamespace(give_back=lambda: done.append("sizes")),
    )  # fmt: skip
    frame(lambda: Window._render(window))
    assert done == ["sizes", False, "surface", "opening", "face", "autosave", "idle"]
    assert [failure.place for failure in told] == ["The picture"]


def test_outside_of_a_frame(frame):
    told = []
    assert Guard(told.append).run("Closing", lambda: 3) == 3
    assert Guard(told.append).run("Closing", lambda: [][1]) is None
    assert told == [Failure("Closing", "IndexError: list index out of range", told[0].details)]
