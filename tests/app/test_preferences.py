"""Preferences: what is kept, what is refused, and what they change."""

from __future__ import annotations

import json
import logging

import numpy as np
import pytest
from avatarrex_studio.panels import mouse, theme, units
from avatarrex_studio.session.preferences import (
    Preferences,
    checked,
    preferences_file,
    read_preferences,
    write_preferences,
)

from avatarrex.errors import InputError


def test_they_are_kept():
    assert read_preferences() == Preferences(), "nothing there: the defaults"
    mine = Preferences(mouse="maya", angles="radians", theme="light", scale=1.5, greeting=False)
    write_preferences(mine)
    assert read_preferences() == mine
    assert preferences_file().name == "preferences.json"


@pytest.mark.parametrize(
    ("name", "value"),
    [("mouse", "cad"), ("scale", 9), ("scale", True), ("fps", "60"), ("fps", float("inf")), ("greeting", 1), ("theme", None),
     ("angles", ["degrees"])],
)  # fmt: skip
def test_what_cannot_be_is_said_and_the_rest_is_kept(name, value, caplog):
    with pytest.raises(InputError, match=name):
        checked(name, value)
    file = preferences_file()
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps({"lengths": "cm", name: value, "unknown": 1}))
    with caplog.at_level(logging.WARNING):
        assert read_preferences() == Preferences(lengths="cm")
    assert name in caplog.text
    assert "expected mouse" in caplog.text
    assert "an unknown name" in caplog.text
    assert "preferences.json" in caplog.text


@pytest.mark.parametrize("content", ["", "[]", "{", "null"])
def test_a_broken_file_gives_the_defaults(content, caplog):
    file = preferences_file()
    file.parent.mkdir(parents=True)
    file.write_text(content)
    assert read_preferences() == Preferences()
    assert "preferences.json" in caplog.text
    assert "Expecting" not in caplog.text


def test_a_file_that_cannot_be_written_ends_nothing(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    write_preferences(Preferences(), tmp_path / "file" / "preferences.json")
    assert "preferences.json" in caplog.text


def test_presets_of_the_mouse():
    assert mouse.PRESETS.keys() == mouse.TITLES.keys()
    for preset, drags in mouse.PRESETS.items():
        assert set(drags.values()) == {mouse.ORBIT, mouse.PAN, mouse.ZOOM}, "everything can be done"
        assert len(mouse.drags(preset)) == 3
    assert mouse.drags("blender")[0] == ("Middle or alt+left drag", "Orbit")


def test_units():
    try:
        units.use("radians", "cm")
        assert (units.angle().text(180), units.length().text(0.5)) == ("3.14", "50 cm")
    finally:
        units.use("degrees", "m")
    assert (units.angle().text(90), units.length().text(0.5)) == ("90°", "0.50 m")


def test_every_colour_of_the_interface_has_one_of_the_light_theme():
    named = {
        tuple(value[:3]) for name, value in theme.COLOURS.items() if name != "modal_window_dim_bg"
    }  # that darkens both
    assert named <= set(theme.LIGHT)
    brightness = {name: sum(theme.LIGHT[getattr(theme, name)]) for name in ("TEXT", "MUTED", "PANEL")}
    assert brightness["TEXT"] < brightness["MUTED"] < brightness["PANEL"] - 1


def contrast(one: theme.Rgb, other: theme.Rgb) -> float:
    """Of two sRGB colours, 1 to 21 (WCAG 2, relative luminance)."""
    values = np.array([one, other])
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    bright, dark = sorted((linear @ [0.2126, 0.7152, 0.0722] + 0.05).tolist(), reverse=True)
    return bright / dark


@pytest.mark.parametrize("name", ["dark", "light"])
def test_curves_and_keys_are_seen_in_both_themes(name, monkeypatch):
    """WCAG wants 3 of what is drawn."""
    monkeypatch.setattr(theme._Present, "light", name == "light")
    shown = [theme.shade(colour) for colour in (*theme.CURVES, theme.KEYS, theme.LIVE)]
    assert len(set(shown)) == len(shown)
    assert min(contrast(colour, theme.shade(theme.BASE)) for colour in shown) > 3
