"""The Poses tab in the window: a card applies a pose, a name keeps one, the other hand follows, Ctrl+Shift+V pastes flipped."""

from __future__ import annotations

import json

import driving
import numpy as np
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.window import Window, start
from ball import ball_engine
from imgui_bundle import imgui

from avatarrex.avatar_file import load_avatar
from avatarrex.signals.library import mirror, named_pose
from avatarrex.signals.macros import hand_values

pytestmark = pytest.mark.window


def test_the_library_is_applied_saved_mirrored_and_pasted(display):
    window = Window(Studio(ExactEngine(ball_engine), Avatars(load_avatar), Journal(start())))
    seen = {}

    def scenario(test):
        test.yield_(6)
        test.window_focus("//Poses")
        test.item_click("//Poses/Wave##pose.wave")
        test.yield_(2)
        seen["wave"], seen["steps"] = window.studio.state.signals, len(window.studio.journal.steps)
        test.item_input_value("//Poses/##own.name", "My wave")
        test.item_click("//Poses/" + "\uf0c7  Save##own")
        test.yield_(2)
        seen["files"] = [path.name for path in (window.poses.own.library.folder / "pose").glob("*")]
        test.item_click("//Poses/\uf2ea  Reset all##poses")
        test.item_check("//Poses/Flipped##poses")
        test.item_click("//Poses/My wave##pose.own.own:My wave")
        test.yield_(2)
        seen["flipped"] = window.studio.state.signals
        seen["text"] = json.dumps(seen["wave"].to_json())
        imgui.set_clipboard_text(seen["text"])
        test.key_press(chord("Ctrl+Shift+V"))
        test.yield_(2)
        seen["pasted"] = window.studio.state.signals
        test.window_focus("//Left hand")
        test.item_check("//Left hand/Both hands##left")
        test.item_input_value("//Left hand/##left.all.curl", 50.0)
        test.yield_(2)
        seen["curled"] = window.studio.state.signals

    driving.drive(window, scenario)
    assert np.allclose(seen["wave"].body_pose, named_pose("wave"))
    assert seen["steps"] == 1
    assert seen["files"] == ["My wave.json"]
    assert np.allclose(seen["flipped"].body_pose, mirror(seen["wave"]).body_pose)
    assert np.allclose(seen["pasted"].body_pose, mirror(seen["wave"]).body_pose)
    for side in ("left", "right"):
        values = hand_values(getattr(seen["curled"], f"{side}_hand_pose"), side)
        assert np.mean([value for (_, macro), value in values.items() if macro == "curl"]) == pytest.approx(
            0.5, abs=0.06
        )
