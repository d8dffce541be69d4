"""What the mouse buttons do to the camera, by preset. The left button alone always takes what is under it."""

from __future__ import annotations

from imgui_bundle import imgui

ORBIT, PAN, ZOOM = "orbit", "pan", "zoom"
LEFT, RIGHT, MIDDLE = 0, 1, 2
PRESETS: dict[str, dict[tuple[int, str], str]] = {
    "default": {(LEFT, ""): ORBIT, (LEFT, "Shift"): PAN, (RIGHT, ""): PAN, (MIDDLE, ""): PAN, (RIGHT, "Alt"): ZOOM},
    "blender": {(MIDDLE, ""): ORBIT, (MIDDLE, "Shift"): PAN, (MIDDLE, "Ctrl"): ZOOM, (LEFT, "Alt"): ORBIT},
    "maya": {(LEFT, "Alt"): ORBIT, (MIDDLE, "Alt"): PAN, (RIGHT, "Alt"): ZOOM},
}
"""What a drag does with a button and a modifier key."""
TITLES = {"default": "Studio", "blender": "Blender", "maya": "Maya"}
_BUTTONS = {LEFT: "left", RIGHT: "right", MIDDLE: "middle"}


def modifier() -> str:
    """The modifier key that is down; empty without one."""
    io = imgui.get_io()
    return next(
        (name for name, down in (("Alt", io.key_alt), ("Shift", io.key_shift), ("Ctrl", io.key_ctrl)) if down), ""
    )


def drags(preset: str) -> list[tuple[str, str]]:
    """What is pressed and what it does, for the sheet: `Shift+left drag`, `Pan`."""
    found: dict[str, list[str]] = {}
    for (button, key), motion in PRESETS[preset].items():
        found.setdefault(motion, []).append(f"{key}+{_BUTTONS[button]}" if key else _BUTTONS[button])
    return [(f"{' or '.join(ways)} drag".capitalize(), motion.capitalize()) for motion, ways in found.items()]
