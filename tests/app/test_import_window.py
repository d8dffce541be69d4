"""A capture of another layout through the real window: chosen from the menu, looked at, imported, filled in for a training."""

from __future__ import annotations

import time

import pytest
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.window import Window, start
from ball_studio import ball_studio
from capture import foreign
from driving import drive, until
from imgui_bundle import icons_fontawesome_6 as icons

from avatarrex.capture.readers.rigs import open_capture

pytestmark = pytest.mark.window


def test_a_capture_is_looked_at_imported_and_filled_in(display, tmp_path, monkeypatch):
    """The true verb on a tiny ZJU-MoCap: first three frames with the template over them, then all."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    foreign.BODIES["ZJU-MoCap"](foreign.scene(), tmp_path / "zju")
    window = Window(ball_studio(time.monotonic, journal=Journal(start())), tmp_path / "runs")
    panel, seen = window.training, {}
    form = panel.tools.imported

    def press(test, title, seconds=200):
        test.item_click(f"**/{title}")
        assert until(test, lambda: panel.tasks.task is None and panel.tasks.outcome is not None, seconds)
        test.yield_(20)  # until its picture is there
        outcome, panel.tasks.outcome = panel.tasks.outcome, None
        return outcome

    def scenario(test):
        test.yield_(6)
        test.menu_click("//##MainMenuBar/File/Import a capture…")
        test.yield_(6)
        form.files.go(str(tmp_path))
        form.files.name = "zju"
        test.yield_(3)
        test.item_click("**/###answer")
        test.yield_(6)
        seen["source"] = form.source
        seen["look"] = press(test, f"{icons.ICON_FA_EYE}  Look first##import.look")
        seen["whole"] = press(test, f"{icons.ICON_FA_FILE_IMPORT}  Import##import.whole")

    drive(window, scenario)
    assert seen["source"] == str(tmp_path / "zju")
    assert "axes: the person stands along +Z" in seen["look"].text
    assert "verdict: " in seen["look"].text
    assert seen["look"].task.pictures[0].is_file()
    assert seen["whole"].done, seen["whole"].text
    assert panel.form.capture == str(tmp_path / "zju_imported")
    assert open_capture(panel.form.capture).rigs["body"].frames == 3
