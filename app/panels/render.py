"""The Render panel: image size and background."""

from __future__ import annotations

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.commands import Command, SetBackground, SetSize
from avatarrex_studio.session.state import BACKGROUND, Colour, StudioState
from imgui_bundle import imgui

LABEL = 90.0
SIZES: tuple[tuple[str, SetSize], ...] = (
    ("Viewport", SetSize()),
    ("Viewport, half", SetSize(scale=0.5)),
    ("Viewport, double", SetSize(scale=2.0)),
    ("512 × 512", SetSize(fixed=(512, 512))),
    ("1024 × 1024", SetSize(fixed=(1024, 1024))),
    ("1280 × 720", SetSize(fixed=(1280, 720))),
    ("1920 × 1080", SetSize(fixed=(1920, 1080))),
)
BACKGROUNDS: tuple[tuple[str, Colour], ...] = (
    ("Studio", BACKGROUND),
    ("White", (1.0, 1.0, 1.0, 1.0)),
    ("Grey", (0.5, 0.5, 0.5, 1.0)),
    ("Black", (0.0, 0.0, 0.0, 1.0)),
    ("Clear", (0.0, 0.0, 0.0, 0.0)),
)


def draw(state: StudioState) -> list[Command]:
    """Draw the panel; the commands of this frame."""
    commands: list[Command] = []
    widgets.label("Size", False, LABEL)
    imgui.set_next_item_width(imgui.get_content_region_avail().x)
    policy = (state.size.scale, state.size.fixed)
    current = next((title for title, entry in SIZES if (entry.scale, entry.fixed) == policy), "Other")
    if imgui.begin_combo("##size", current):
        for title, entry in SIZES:
            if imgui.selectable(title, title == current)[0]:
                commands.append(entry)
        imgui.end_combo()
    widgets.label("Background", False, LABEL)
    imgui.set_next_item_width(imgui.get_content_region_avail().x)
    moved, colour = imgui.color_edit3("##background", list(state.background[:3]), imgui.ColorEditFlags_.display_hex)
    if moved:
        red, green, blue = colour[0], colour[1], colour[2]
        commands.append(SetBackground((red, green, blue, 1.0)))
    pressed = widgets.button_grid([(f"background.{title}", title) for title, _ in BACKGROUNDS], 58)
    commands += [SetBackground(value) for title, value in BACKGROUNDS if pressed == f"background.{title}"]
    return commands
