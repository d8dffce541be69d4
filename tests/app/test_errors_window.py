"""What goes wrong and what would be lost, in the window: toasts, dialogs, keys while one is open, saving, closing, recovery."""

from __future__ import annotations

import json
import logging

import driving
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.session.autosave import Autosave
from avatarrex_studio.session.commands import ApplyPose, SetLevel
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.window import Window, start
from ball import ball_engine
from imgui_bundle import hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from avatarrex.avatar_file import load_avatar

pytestmark = pytest.mark.window
ESCAPE, ENTER = int(imgui.Key.escape), int(imgui.Key.enter)


def drive(scenario):
    """Open a window whose log is read as in the program, run `scenario(test, window)`, close it."""
    window = Window(Studio(ExactEngine(ball_engine), Avatars(load_avatar), Journal(start())))
    logging.getLogger().addHandler(window.toasts)
    try:
        driving.drive(window, lambda test: (test.yield_(6), scenario(test, window)))
    finally:
        logging.getLogger().removeHandler(window.toasts)
    return window


def opened():
    """Whether a menu or a dialog is open."""
    return imgui.is_popup_open("", imgui.PopupFlags_.any_popup)


def test_toasts_dialogs_and_keys(display, tmp_path):
    seen = {}

    def scenario(test, window):
        window.studio.do(SetLevel("none"))
        test.yield_(3)
        seen["toast"] = window.toasts.shown[0].title
        test.item_click(f"//Timeline/{icons.ICON_FA_FOLDER_OPEN}##motion")
        test.yield_(4)
        seen["folder icon"] = opened()
        test.key_press(ESCAPE)
        test.yield_(3)
        window.studio.open_motion(str(tmp_path / "none.bvh"))
        test.yield_(4)
        seen["dialog"] = [question.text for question in window.questions.waiting]
        window.studio.do(ApplyPose("wave"))
        pose = window.studio.state
        for key in ("M", "Ctrl+Z", "1", "Space"):
            test.key_press(chord(key))
        test.yield_(3)
        seen["keys"] = window.studio.state is pose
        test.key_press(ESCAPE)
        test.yield_(3)
        seen["closed"] = (opened(), len(window.questions.waiting))
        for key in ("Ctrl+P", "F1"):
            test.key_press(chord(key))
            test.yield_(3)
            seen[key] = opened()
            test.key_press(ESCAPE)
            test.yield_(3)
            seen[key] = (seen[key], opened())
        test.key_press(chord("M"))
        test.yield_(3)
        seen["mirrored"] = window.studio.state is not pose

    drive(scenario)
    assert seen["toast"] == "level: found none"
    assert seen["folder icon"]
    assert len(seen["dialog"]) == 1
    assert "none.bvh" in seen["dialog"][0]
    assert "nothing there" in seen["dialog"][0]
    assert seen["keys"], "keys do nothing while a dialog is open"
    assert seen["closed"] == (False, 0)
    assert seen["Ctrl+P"] == seen["F1"] == (True, False)
    assert seen["mirrored"]


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", ""])
def test_a_name_that_no_file_can_have_is_refused(studio, tmp_path, caplog, name):
    window = Window(studio)
    studio.do(ApplyPose("wave"))
    window._save_as()
    window.files._then(str(tmp_path / name))
    assert not window.questions.waiting
    (record,) = (record for record in caplog.records if record.levelno == logging.ERROR)
    assert str(tmp_path) in record.getMessage()
    assert studio.journal.unsaved


def test_saving_and_closing(display, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen, file = {}, tmp_path / "mine.json"

    def scenario(test, window):
        studio, params = window.studio, hello_imgui.get_runner_params()
        seen["nothing to save"] = window._may_close()
        studio.do(ApplyPose("wave"))
        pose = studio.state
        test.key_press(chord("Ctrl+S"))
        test.yield_(6)
        test.key_chars("mine")
        test.yield_(2)
        seen["typed"] = studio.state is pose
        test.key_press(ENTER)
        test.yield_(4)
        seen["written"] = file.exists()
        studio.do(ApplyPose("sit"))
        seen["unsaved"] = studio.journal.unsaved
        test.key_press(chord("Ctrl+S"))
        test.yield_(4)
        seen["at once"] = (opened(), len(json.loads(file.read_text())["steps"]))
        test.key_press(chord("Ctrl+Shift+S"))
        test.yield_(6)
        test.key_chars("mine")
        test.yield_(2)
        test.key_press(ENTER)
        test.yield_(4)
        seen["overwrite"] = [question.title for question in window.questions.waiting]
        test.key_press(ESCAPE)
        test.yield_(3)
        studio.do(ApplyPose("squat"))
        test.key_press(chord("Ctrl+Q"))
        test.yield_(4)
        seen["leaving"] = ([question.title for question in window.questions.waiting], params.app_shall_exit)
        test.key_press(ESCAPE)
        test.yield_(3)
        seen["stays"] = (len(window.questions.waiting), params.app_shall_exit)

    window = drive(scenario)
    assert seen["nothing to save"]
    assert seen["typed"], "the name is typed into the field"
    assert seen["written"]
    assert seen["unsaved"]
    assert seen["at once"] == (False, 2)
    assert seen["overwrite"] == ["Overwrite the file?"]
    assert seen["leaving"] == (["Save your work?"], False)
    assert seen["stays"] == (0, False)
    assert not window.autosave.file.exists(), "a clean end leaves nothing"


def test_a_crash_is_recovered(display, tmp_path):
    lost = Journal(start())
    lost.do(ApplyPose("wave"))
    kept = Autosave(clock=iter((0.0, 60.0, 60.0, 60.0)).__next__)
    kept.file = kept.folder / "recovery-999999999.json"
    kept.tend(lost)
    kept._thread.shutdown()
    seen = {}

    def scenario(test, window):
        seen["question"] = [question.title for question in window.questions.waiting]
        test.yield_(2)
        test.key_press(ENTER)
        test.yield_(4)
        seen["state"], seen["unsaved"] = window.studio.state, window.studio.journal.unsaved

    drive(scenario)
    assert seen["question"] == ["Recover your work?"]
    assert seen["state"].signals == lost.state.signals
    assert seen["unsaved"]
    assert Autosave().found() == []
