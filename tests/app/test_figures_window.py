"""Several avatars in the window, as a user has them: added, placed, clicked on, undone, saved and opened again."""

from __future__ import annotations

import numpy as np
import pytest
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.screen import Screen
from avatarrex_studio.window.window import start
from ball import ball_engine
from imgui_bundle import imgui
from test_window import drive, surfaced

pytestmark = pytest.mark.window


def test_a_second_avatar_is_added_placed_selected_and_kept(display, monkeypatch, tmp_path):
    seen, shown = {}, {}

    def read(screen, studio, new, show=Screen.show):
        show(screen, studio, new)
        if new and screen.shown:
            size = screen.shown.width, screen.shown.height
            texture = screen.context.external_texture(screen.shown.texture, size, 4, 0, "f1")
            shown["image"] = np.frombuffer(texture.read(), np.uint8).reshape(size[1], size[0], 4)

    def click_on(test, studio, figure):
        """On a figure's chest."""
        picture = test.item_info("//Viewport/picture").rect_full
        chest = studio.state.each()[figure].signals.translation + np.array([0.0, 0.1, 0.1])
        place = Projection.of(studio.state.view, picture.min, picture.max).screen(chest)
        test.mouse_move_to_pos(imgui.ImVec2(*map(float, place)))
        test.yield_(2)
        test.mouse_click(0)
        test.yield_(4)

    def scenario(test, window):
        studio = window.studio
        test.yield_(20)
        test.window_focus("//Performance")
        test.set_ref("//Performance")
        test.combo_click("##level/live")
        test.yield_(5)
        test.window_focus("//Scene")
        test.set_ref("//Scene")
        test.item_click("###figure.add")
        test.yield_(3)
        test.item_click("//$FOCUSED/###figure.add.default")
        test.yield_(5)
        seen["added"] = studio.state
        test.item_input_value("##place.turn", -60.0)
        test.item_input_value("##place.x", 0.8)
        test.yield_(3)
        seen["placed"] = studio.state
        test.mouse_move_to_pos(test.item_info("//Viewport/picture").rect_full.get_center())
        test.key_press(chord("Home"))
        test.yield_(5)
        seen["both"] = shown["image"].copy()
        click_on(test, studio, 0)
        seen["clicked"] = studio.state
        click_on(test, studio, 1)
        seen["back"] = studio.state
        test.key_press(chord("A"))
        test.yield_(4)
        seen["next"] = studio.state
        test.yield_(3)
        seen["same"] = shown["image"].copy()
        test.item_click("###figure.remove.1")
        test.yield_(5)
        seen["removed"], seen["one"] = studio.state, shown["image"].copy()
        test.key_press(chord("Ctrl+Z"))
        test.yield_(5)
        seen["undone"] = studio.state
        studio.save_session(str(tmp_path / "a.json"))
        before = shown["image"].copy()
        studio.take_journal(Journal(start()))
        test.yield_(5)
        window.opening.open(str(tmp_path / "a.json"))
        while window.opening.busy or studio.avatars.reading:
            test.yield_()
        test.yield_(5)
        seen["kept"], seen["images"] = studio.state, (before, shown["image"].copy())

    monkeypatch.setattr(Screen, "show", read)
    drive(ball_engine, scenario, live=LiveSurface(), load=surfaced)
    assert (len(seen["added"].figures), seen["added"].slot, seen["added"].place.x) == (2, 1, 1.0)
    place = seen["placed"].place
    assert (place.turn, place.x) == (pytest.approx(-60), pytest.approx(0.8))
    assert seen["placed"].figures[0] == seen["added"].figures[0]
    assert (seen["clicked"].slot, seen["back"].slot, seen["next"].slot) == (0, 1, 0)
    assert seen["clicked"].tools.selected is not None, "a part of the one that was clicked on"
    assert np.array_equal(seen["both"], seen["same"]), "selecting changes nothing that is seen"
    assert len(seen["removed"].figures) == 1
    assert (seen["one"] != seen["both"]).any(-1).sum() > 2000
    assert seen["undone"].figures == seen["next"].figures
    assert seen["kept"].figures == seen["undone"].figures
    first, second = (image.astype(int) for image in seen["images"])
    assert np.abs(first - second).max() <= 1, "the saved session shows the same"
