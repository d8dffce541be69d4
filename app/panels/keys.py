"""Shortcuts as text (`Ctrl+Shift+Z`) and as the toolkit's key chords; a digit is also that of the keypad."""

from __future__ import annotations

from imgui_bundle import imgui

MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}
NAMED = {"Left": imgui.Key.left_arrow, "Right": imgui.Key.right_arrow, ",": imgui.Key.comma}

KEYPAD = {int(getattr(imgui.Key, f"_{digit}")): getattr(imgui.Key, f"keypad{digit}") for digit in range(10)}


def free() -> bool:
    """Whether a key is a shortcut: no text is typed, and neither menu nor dialog is open."""
    return not (imgui.get_io().want_text_input or imgui.is_popup_open("", imgui.PopupFlags_.any_popup))


def close_topmost() -> bool:
    """Close the menu, list or dialog that was opened last, where Esc was pressed; whether there was one."""
    opened = imgui.get_current_context().open_popup_stack.size()
    if not opened or not imgui.is_key_pressed(imgui.Key.escape, False):
        return False
    imgui.internal.close_popup_to_level(opened - 1, True)
    return True


def chord(shortcut: str) -> int:
    """The key chord of a shortcut. Raises `KeyError` or `AttributeError` for an unknown key."""
    *modifiers, key = shortcut.split("+")
    code = int(NAMED.get(key) or getattr(imgui.Key, f"_{key}" if key.isdigit() else key.lower()))
    for name in modifiers:
        code |= int(MODIFIERS[name])
    return code


def pressed(chord: int) -> bool:
    """Whether a chord was pressed in this frame, also where its modifiers were let go in the same one.

    The toolkit takes a key and the release of Ctrl that arrive together into one frame, in which Ctrl is up already.
    """
    down = sum(int(key) for key in MODIFIERS.values() if imgui.is_key_down(key) or imgui.is_key_released(key))
    wanted = chord & sum(map(int, MODIFIERS.values()))
    key = chord - wanted
    twins = (imgui.Key(key), KEYPAD.get(key, imgui.Key(key)))
    return down == wanted and any(imgui.is_key_pressed(twin, False) for twin in twins)


def anything() -> bool:
    """Whether a key, a button or the wheel was used in this frame."""
    io = imgui.get_io()
    pressed = (
        imgui.is_key_pressed(imgui.Key(code), False)
        for code in range(int(imgui.Key.named_key_begin), int(imgui.Key.named_key_end))
    )
    return bool(imgui.is_any_mouse_down() or io.mouse_wheel or any(pressed))
