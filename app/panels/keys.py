"""Shortcuts as text (`Ctrl+Shift+Z`) and as the toolkit's key chords."""

from __future__ import annotations

from imgui_bundle import imgui

MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}
NAMED = {
    "Home": imgui.Key.home,
    "Space": imgui.Key.space,
    "LeftArrow": imgui.Key.left_arrow,
    "RightArrow": imgui.Key.right_arrow,
    "F1": imgui.Key.f1,
    "F12": imgui.Key.f12,
}


def chord(shortcut: str) -> int:
    """The key chord of a shortcut. Raises `KeyError` or `AttributeError` for an unknown key."""
    *modifiers, key = shortcut.split("+")
    code = int(NAMED.get(key) or getattr(imgui.Key, f"_{key}" if key.isdigit() else key.lower()))
    for name in modifiers:
        code |= int(MODIFIERS[name])
    return code


def shown(shortcut: str) -> str:
    """As a person reads it, in the fonts that are loaded."""
    for name, text in {"LeftArrow": "Left", "RightArrow": "Right"}.items():
        shortcut = shortcut.replace(name, text)
    return shortcut
