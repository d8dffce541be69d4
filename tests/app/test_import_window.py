"""A capture of another layout through the real window: chosen from the menu, looked at, imported, filled in for a training."""

from __future__ import annotations

import pytest
from avatarrex_studio.panels.keys import chord
from capture import foreign
from driving import drive, until
from imgui_bundle import icons_fontawesome_6 as icons
from test_fuzz_window import small_window

from avatarrex.capture.readers.rigs import open_capture

pytestmark = pytest.mark.window


def test_a_capture_is_imported_and_filled_in(display, tmp_path, monkeypatch):
    """The true verb on a tiny ZJU-MoCap. *Look first* draws the template over each picture and is cancelled: it takes ten times as long."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    foreign.BODIES["ZJU-MoCap"](foreign.scene(scale=1), tmp_path / "zju")
    window, seen = small_window(), {}
    panel = window.training
    form = panel.tools.imported

    def ended(test):
        assert until(test, lambda: panel.tasks.task is None and panel.tasks.outcome is not None, 90)
        outcome, panel.tasks.outcome = panel.tasks.outcome, None
        test.yield_(4)
        return outcome

    def scenario(test):
        test.yield_(10)
        test.key_press(chord("Tab"))  # panels are hidden: the form is shown all the same
        test.yield_(3)
        test.menu_click("//##MainMenuBar/File/Import a capture…")
        test.yield_(6)
        form.files.go(str(tmp_path))
        test.yield_(3)
        test.item_click("**/##name")
        test.key_chars_replace("zju")
        test.yield_(3)
        test.item_click("**/###answer")
        test.yield_(6)
        seen["source"] = form.source
        test.item_click(f"**/{icons.ICON_FA_EYE}  Look first##import.look")
        assert until(test, lambda: panel.tasks.task is not None, 5)
        panel.tasks.cancel()
        seen["look"] = ended(test)
        test.item_click(f"**/{icons.ICON_FA_FILE_IMPORT}  Import##import.whole")
        seen["whole"] = ended(test)

    drive(window, scenario)
    assert seen["source"] == str(tmp_path / "zju")
    assert seen["look"].task.words[:3] == ("capture", "import", seen["source"])
    assert "--preview" in seen["look"].task.words
    assert not seen["look"].done
    assert seen["whole"].done, seen["whole"].text
    assert "mattes are labels" in seen["whole"].text, "what was found is told"
    assert panel.form.capture == str(tmp_path / "zju_imported")
    assert open_capture(panel.form.capture).rigs["body"].frames == 3
