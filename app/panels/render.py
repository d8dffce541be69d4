"""The Render panel: image size and background."""

from __future__ import annotations

from collections.abc import Iterator

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.commands import Command, SetBackground, SetSize
from avatarrex_studio.session.state import BACKGROUND, Colour, SizePolicy, StudioState
from imgui_bundle import imgui

LABEL = 90.0
POLICIES = {
    "Viewport": SizePolicy(),
    "Viewport, half": SizePolicy(scale=0.5),
    "Viewport, double": SizePolicy(scale=2.0),
    "512 × 512": SizePolicy(fixed=(512, 512)),
    "1024 × 1024": SizePolicy(fixed=(1024, 1024)),
    "1280 × 720": SizePolicy(fixed=(1280, 720)),
    "1920 × 1080": SizePolicy(fixed=(1920, 1080)),
}
BACKGROUNDS: dict[str, Colour] = {
    "Studio": BACKGROUND,
    "White": (1.0, 1.0, 1.0, 1.0),
    "Grey": (0.5, 0.5, 0.5, 1.0),
    "Black": (0.0, 0.0, 0.0, 1.0),
    "Clear": (0.0, 0.0, 0.0, 0.0),
}


def draw(state: StudioState) -> Iterator[Command]:
    """Draw the panel; the commands of this frame."""
    widgets.label("Size", LABEL)
    current = next((title for title, policy in POLICIES.items() if policy == state.size), "Other")
    if size := widgets.choice("##size", POLICIES, current, current):
        yield SetSize(POLICIES[size].scale, POLICIES[size].fixed)
    widgets.label("Background", LABEL)
    moved, colour = imgui.color_edit3("##background", list(state.background[:3]), imgui.ColorEditFlags_.display_hex)
    if moved:
        yield SetBackground((colour[0], colour[1], colour[2], 1.0))
    if pressed := widgets.button_grid({title: title for title in BACKGROUNDS}, 58, "background."):
        yield SetBackground(BACKGROUNDS[pressed])
