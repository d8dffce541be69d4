"""The Scene panel: the avatars and which parts of the selected one are drawn with their own fields."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.figures import draw as draw_figures
from avatarrex_studio.panels.stage import draw as draw_stage
from avatarrex_studio.session.actions import Action, words
from avatarrex_studio.session.commands import Command, SetHidden, SetShape
from avatarrex_studio.session.posing import SHAPE_RANGE
from avatarrex_studio.session.recent import Recent
from avatarrex_studio.session.state import StudioState
from imgui_bundle import imgui

from avatarrex.templates.parts import PARTS

LABEL = 78.0


def draw(state: StudioState, recent: Recent, add: Callable[[str], None]) -> Iterator[Command | Action]:
    """Draw the panel; the commands of this frame. `add`: have the avatar at a path read and added."""
    yield from draw_figures(state, recent, add)
    for part in PARTS:
        toggled, shown = imgui.checkbox(f"{words(part).capitalize()}##show.{part}", part not in state.hidden)
        if toggled:
            yield SetHidden(part, not shown)
    yield from draw_stage(state)
    if widgets.group("Shape", "scene.shape", opened=False)[0]:
        yield from _shape(state)


def _shape(state: StudioState) -> Iterator[Command]:
    """Ten sliders, within what an avatar can follow."""
    for index, value in enumerate(state.signals.shape):
        widgets.label("Size" if index == 0 else f"Shape {index + 1}", LABEL, bool(value))
        new = widgets.slider(f"shape.{index}", float(value), (-SHAPE_RANGE, SHAPE_RANGE), "%.2f")
        widgets.tooltip("Standard deviations; fields were learned on one shape and follow the skin")
        if new is not None:
            yield SetShape(index, new)
