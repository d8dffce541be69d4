"""The dialog of preferences: each takes effect at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from avatarrex_studio.panels import mouse, widgets
from avatarrex_studio.session.preferences import CHOICES, RANGES, Preferences
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

TITLE = "Preferences###preferences"
WIDTH, LABEL = 470.0, 150.0
NAMES = {"mouse": "Mouse", "angles": "Angles", "lengths": "Lengths", "theme": "Theme"}
WORDS: dict[str, str] = {**mouse.TITLES, "m": "Metres", "cm": "Centimetres"}


class PreferencesDialog:
    """Closed at first."""

    def __init__(self) -> None:
        self._opening = False
        self._scale: float | None = None
        """While it is dragged: nothing changes its size under the mouse."""

    def open(self) -> None:
        """Show it at the next frame."""
        self._opening = True

    def draw(self, now: Preferences) -> Preferences:
        """Draw the dialog where it is open; the preferences after it."""
        if self._opening:
            imgui.open_popup(TITLE)
            self._opening = False
        screen = imgui.get_main_viewport()
        imgui.set_next_window_pos(screen.get_center(), imgui.Cond_.always, (0.5, 0.5))
        imgui.set_next_window_size((min(WIDTH, screen.size.x - 20), 0))
        if not imgui.begin_popup_modal(
            TITLE, None, imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_saved_settings
        )[0]:
            return now
        changed: dict[str, Any] = self._choices(now)
        changed.update(self._numbers(now))
        for name, title, tip in (
            ("greeting", "Move gently at first", "The avatar breathes and looks about until the first thing you do"),
            ("hint", "Show the hint in the menu bar", "The line that tells how to begin"),
        ):
            widgets.label("", LABEL)
            toggled, on = imgui.checkbox(f"{title}##preferences", getattr(now, name))
            widgets.tooltip(tip)
            changed.update({name: on} if toggled else {})
        imgui.spacing()
        if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}  Defaults##preferences", (132, 0)):
            now, changed = Preferences(), {}
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_CHECK}  Close##preferences", (132, 0)):
            imgui.close_current_popup()
        imgui.end_popup()
        return replace(now, **changed) if changed else now

    def _choices(self, now: Preferences) -> dict[str, Any]:
        changed = {}
        for name, title in NAMES.items():
            widgets.label(title, LABEL)
            for value in widgets.in_rows(CHOICES[name]):
                pressed = imgui.radio_button(
                    f"{WORDS.get(value, value.capitalize())}##{name}", getattr(now, name) == value
                )
                changed.update({name: value} if pressed else {})
            if name == "mouse":
                widgets.label("", LABEL)
                imgui.begin_group()
                for ways, what in mouse.drags(now.mouse):
                    widgets.caption(f"{ways}: {what.lower()}")
                imgui.end_group()
        return changed

    def _numbers(self, now: Preferences) -> dict[str, Any]:
        changed: dict[str, Any] = {}
        widgets.label("Size of text and all", LABEL)
        low, high = RANGES["scale"]
        value = now.scale if self._scale is None else self._scale
        new = widgets.slider("preferences.scale", 100 * value, (100 * low, 100 * high), "%.0f %%", rest=100)
        if new is not None:
            self._scale = round(new / 5) * 0.05
        elif self._scale is not None and not imgui.is_item_active():
            changed["scale"], self._scale = min(max(self._scale, low), high), None
        widgets.label("Frames a second", LABEL)
        new = widgets.slider("preferences.fps", now.fps, RANGES["fps"], "at most %.0f", rest=60)
        if new is not None:
            changed["fps"] = round(new)
        return changed
