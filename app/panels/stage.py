"""The stage in the Scene panel: floor, light, background, exposure."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.actions import Action, action
from avatarrex_studio.session.commands import Command, SetBackground, SetStage
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.errors import plain
from avatarrex.stage.stage import COLOUR, GRADIENT, LIMITS, PICTURE, Stage

LABEL = 88.0
BACKDROPS = {GRADIENT: "Gradient", COLOUR: "One colour", PICTURE: "Picture"}
SLIDERS = (
    ("azimuth", "Light from", "%.0f°", "Where the light stands: 0° before the person, 90° at the person's left"),
    ("elevation", "Light height", "%.0f°", "Low light throws long shadows"),
    ("softness", "Softness", "%.1f°", "How large the light is: a large one has soft shadows"),
    ("shadow", "Darkness", "%.2f", "How dark shadows are"),
)
"""Field, label, format, tooltip."""
FIRST: dict[str, Any] = {field.name: field.default for field in fields(Stage)}
"""What a stage begins with."""


def draw(state: StudioState) -> Iterator[Command | Action]:
    """Draw the section; the commands of this frame."""
    stage = state.stage
    marked = Stage(shown=stage.shown) != stage
    opened, reset = widgets.group("Stage", "scene.stage", marked)
    if reset:
        yield from (SetStage(name, value) for name, value in FIRST.items() if name != "shown")
    if not opened:
        return
    toggled, shown = imgui.checkbox("Shown##stage.shown", stage.shown)
    widgets.tooltip("Floor, light and background. Exports have them where you tick Stage there.")
    if toggled:
        yield SetStage("shown", shown)
    imgui.same_line()
    imgui.begin_disabled(not stage.shown)
    toggled, floor = imgui.checkbox("Floor##stage.floor", stage.floor)
    widgets.tooltip("What shadows lie on")
    if toggled:
        yield SetStage("floor", floor)
    for name, title, form, tip in SLIDERS:
        yield from _slider(stage, name, title, form, tip)
    yield from _backdrop(state)
    yield from _slider(stage, "exposure", "Exposure", "%.2f", "Brightness of the whole picture, in stops")
    imgui.end_disabled()


def _slider(stage: Stage, name: str, title: str, form: str, tip: str) -> Iterator[Command]:
    value, first = float(getattr(stage, name)), float(FIRST[name])
    low, high = (-180.0, 180.0) if name == "azimuth" else LIMITS[name]
    widgets.label(title, LABEL, value != first)
    new = widgets.slider(f"stage.{name}", value, (low, high), form, rest=first)
    widgets.tooltip(tip)
    if new is not None:
        yield SetStage(name, new)


def _backdrop(state: StudioState) -> Iterator[Command | Action]:
    """What is behind, and its colours."""
    stage = state.stage
    widgets.label("Behind", LABEL, stage.backdrop != GRADIENT)
    title = BACKDROPS[stage.backdrop]
    if picked := widgets.choice("##stage.backdrop", BACKDROPS.values(), title, title):
        kind = next(name for name, shown in BACKDROPS.items() if shown == picked)
        if kind == PICTURE and not stage.picture:
            yield action("stage.picture")
        else:
            yield SetStage("backdrop", kind)
    if stage.backdrop == PICTURE:
        widgets.label("Picture", LABEL)
        if imgui.button(
            f"{icons.ICON_FA_FOLDER_OPEN}  {plain(os.path.basename(stage.picture))}##stage.picture", (-1, 0)
        ):
            yield action("stage.picture")
        widgets.tooltip(plain(stage.picture))
    elif stage.backdrop == COLOUR:
        widgets.label("Colour", LABEL)
        moved, colour = imgui.color_edit3(
            "##stage.colour", list(state.background[:3]), imgui.ColorEditFlags_.display_hex
        )
        if moved:
            yield SetBackground((colour[0], colour[1], colour[2], 1.0))
    else:
        for name, words in (("top", "Above"), ("bottom", "Below")):
            widgets.label(words, LABEL, getattr(stage, name) != FIRST[name])
            chosen = list(getattr(stage, name))
            moved, colour = imgui.color_edit3(f"##stage.{name}", chosen, imgui.ColorEditFlags_.display_hex)
            if moved:
                yield SetStage(name, (colour[0], colour[1], colour[2]))
