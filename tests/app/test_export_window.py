"""Export and the output window, through the real window: dialog, overwriting, progress, cancel, toasts; the avatar over a key colour."""

from __future__ import annotations

import logging
import os

import driving
import glfw
import numpy as np
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.window import Window, start
from ball import ball_engine
from driving import until
from imgui_bundle import hello_imgui, imgui
from PIL import Image

from avatarrex.avatar_file import load_avatar

pytestmark = pytest.mark.window
ENTER = int(imgui.Key.enter)


def export(test, window, kind, **fields):
    """Fill in the dialog and press Export."""
    test.key_press(chord("Ctrl+E"))
    test.yield_(6)
    test.item_click(f"**/##kind.{kind}")
    test.yield_(3)
    for name, value in fields.items():
        setattr(window.exports.dialog.form, name, value)
    test.yield_(3)
    test.item_click("**/###answer")
    test.yield_(4)


def spied(monkeypatch, window):
    """The last picture that the output window was about to show, row 0 at the top, in a list of at most one."""
    pixels, swap = [], glfw.swap_buffers

    def read(shown):
        pane = window.output.pane
        width, height = pane.size
        content = pane._context.screen.read((0, 0, width, height), 4)
        pixels[:] = [np.frombuffer(content, np.uint8).reshape(height, width, 4)[::-1]]
        swap(shown)

    monkeypatch.setattr(glfw, "swap_buffers", read)
    return pixels


def test_export_and_output(display, tmp_path, monkeypatch, caplog):
    caplog.set_level(logging.INFO)  # toasts tell where a file was written
    monkeypatch.chdir(tmp_path)
    window = Window(Studio(ExactEngine(ball_engine), Avatars(load_avatar), Journal(start())), make=ball_engine)
    output, seen = spied(monkeypatch, window), {}

    def scenario(test):
        test.yield_(8)
        export(test, window, "Picture", size=(200, 256), clear=True, marked=True, name="mine")
        seen["at work"] = window.exports.busy
        until(test, lambda: not window.exports.busy)
        test.yield_(3)
        seen["toast"] = [toast.title for toast in window.toasts.shown]
        with Image.open(tmp_path / "mine.png") as image:
            seen["picture"] = image.mode
        before = (tmp_path / "mine.png").stat().st_mtime_ns
        export(test, window, "Picture", name="mine")
        until(test, lambda: window.questions.waiting)
        seen["question"] = [question.title for question in window.questions.waiting]
        test.yield_(3)
        test.key_press(int(imgui.Key.escape))
        test.yield_(3)
        seen["kept"] = (tmp_path / "mine.png").stat().st_mtime_ns == before
        export(test, window, "Picture", name="mine", size=(100, 100))
        until(test, lambda: window.exports.dialog.error)
        seen["refusal"] = window.exports.dialog.error
        test.yield_(3)
        test.key_press(int(imgui.Key.escape))
        test.yield_(3)
        long = {"seconds": 600.0, "rate": 30.0, "size": (64, 64), "marked": False, "name": "clip"}
        export(test, window, "Video", **long)
        until(test, lambda: window.exports.process.progress and window.exports.process.progress.done > 1)
        seen["closing"] = window._may_close()
        test.yield_(3)
        test.key_press(ENTER)
        test.yield_(3)
        seen["words"] = window.exports.words
        test.item_click("//Exporting/###cancel")
        until(test, lambda: not window.exports.busy)
        seen["files"] = sorted(os.listdir(tmp_path))
        test.key_press(chord("F9"))
        until(test, lambda: window.output.pane is not None, 20)
        test.menu_click("//##MainMenuBar/Live output/Output over key green")
        test.yield_(3)
        until(test, lambda: output and output[0][2, 2, 1] == 255, 20)
        seen["output"] = output[0]
        test.menu_click("//##MainMenuBar/Live output/Virtual camera")
        test.yield_(3)
        seen["camera"] = [toast.title for toast in window.toasts.shown]
        test.key_press(chord("F9"))
        test.yield_(4)
        seen["closed"] = window.output.pane is None and hello_imgui.get_runner_params().app_shall_exit is False

    monkeypatch.setitem(__import__("sys").modules, "pyvirtualcam", None)
    logging.getLogger().addHandler(window.toasts)
    try:
        driving.drive(window, scenario)
    finally:
        logging.getLogger().removeHandler(window.toasts)
    assert seen["at work"]
    assert any(str(tmp_path / "mine.png") in title for title in seen["toast"])
    assert seen["picture"] == "RGBA"
    assert seen["question"] == ["Overwrite the file?"]
    assert seen["kept"]
    assert "192" in seen["refusal"]
    assert seen["closing"] is False
    assert "left" in seen["words"]
    assert seen["files"] == ["mine.png"], "a cancelled video leaves nothing"
    corner, middle = seen["output"][2, 2], seen["output"][seen["output"].shape[0] // 2, seen["output"].shape[1] // 2]
    assert corner.tolist() == [0, 255, 0, 255]
    assert np.abs(middle.astype(int) - corner).max() > 40
    assert any("pip install" in title for title in seen["camera"])
    assert seen["closed"]
