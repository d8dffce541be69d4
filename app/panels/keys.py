"""Shortcuts as text (`Ctrl+Shift+Z`) and as the toolkit's key chords."""

from __future__ import annotations

from imgui_bundle import imgui

MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}
ARROWS = {"Left": imgui.Key.left_arrow, "Right": imgui.Key.right_arrow}


def chord(shortcut: str) -> int:
    """The key chord of a shortcut. Raises `KeyError` or `AttributeError` for an unknown key."""
    *modifiers, key = shortcut.split("+")
    code = int(ARROWS.get(key) or getattr(imgui.Key, f"_{key}" if key.isdigit() else key.lower()))
    for name in modifiers:
        code |= int(MODIFIERS[name])
    return code
