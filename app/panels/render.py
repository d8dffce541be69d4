"""The Render panel: image size and background."""

from __future__ import annotations

from collections.abc import Iterator

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.commands import Command, SetBackground, SetSize, SetStage
from avatarrex_studio.session.state import BACKGROUND, Colour, SizePolicy, StudioState
from imgui_bundle import imgui

from avatarrex.stage.stage import COLOUR

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
    "Slate": BACKGROUND,
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
        yield from behind(state, (colour[0], colour[1], colour[2], 1.0))
    if pressed := widgets.button_grid({title: title for title in BACKGROUNDS}, 58, "background."):
        yield from behind(state, BACKGROUNDS[pressed])


def behind(state: StudioState, colour: Colour) -> Iterator[Command]:
    """A colour behind the figure: over a gradient or picture of the stage; one that is clear takes the stage away."""
    yield SetBackground(colour)
    if state.stage.shown and not colour[3]:
        yield SetStage("shown", False)
    elif state.stage.shown and state.stage.backdrop != COLOUR:
        yield SetStage("backdrop", COLOUR)
