"""The avatars in the Scene panel: which there are, which one the panels show, where it stands."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace

from avatarrex_studio.panels import theme, units, widgets
from avatarrex_studio.session.actions import Action, action
from avatarrex_studio.session.commands import AddFigure, Command, PlaceFigure, RemoveFigure, SelectFigure
from avatarrex_studio.session.figures import MOST_FIGURES, Place
from avatarrex_studio.session.recent import Recent
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

from avatarrex.errors import plain

LABEL = 78.0
FAR = 3.0
"""Metres either way that a slider reaches, and beyond the figure where that stands farther."""
SLIDERS = (
    ("turn", "Turn", "About the vertical: 90° faces to the right of the front view"),
    ("x", "Sideways", "To the right of the front view"),
    ("z", "Forward", "Towards the front view"),
)
"""Entry of the place, label, tooltip."""


def draw(state: StudioState, recent: Recent, add: Callable[[str], None]) -> Iterator[Command | Action]:
    """Draw the section; the commands of this frame. `add`: have the avatar at a path read and added."""
    figures = state.figures
    names = [plain(os.path.basename(figure.avatar)) for figure in figures]
    for index, figure in enumerate(figures):
        again = names[:index].count(names[index])
        title = f"{names[index]} {again + 1}" if again else names[index]
        yield from _row(index, title, index == state.slot, len(figures) > 1)
        widgets.tooltip(plain(figure.avatar))
    yield from _adding(state, recent, add)
    if len(figures) > 1 or state.place != Place():
        yield from _place(state.place)


def _row(index: int, title: str, selected: bool, several: bool) -> Iterator[Command]:
    """A figure, and the button that removes it."""
    right = imgui.get_cursor_pos_x() + widgets.room()
    colour = theme.ACCENT if selected else theme.MUTED
    imgui.text_colored(theme.vec4(colour), icons.ICON_FA_PERSON)
    imgui.same_line()
    if not several:
        imgui.text(title)
        return
    imgui.set_next_item_allow_overlap()
    if imgui.selectable(f"{title}###figure.{index}", selected)[0] and not selected:
        yield SelectFigure(index)
    row = imgui.is_item_hovered()
    imgui.same_line(right - imgui.calc_text_size(icons.ICON_FA_TRASH).x - 12)
    with imgui_ctx.push_style_color(imgui.Col_.button, theme.vec4(theme.ACCENT, 0.0)):
        if imgui.small_button(f"{icons.ICON_FA_TRASH}###figure.remove.{index}"):
            yield RemoveFigure(index)
    if not row and imgui.is_item_hovered():
        widgets.tooltip("Remove it")


def _adding(state: StudioState, recent: Recent, add: Callable[[str], None]) -> Iterator[Command | Action]:
    """The menu of avatars that can be added: those that are open, those that were, and any other."""
    imgui.begin_disabled(len(state.figures) >= MOST_FIGURES)
    if imgui.button(f"{icons.ICON_FA_PLUS}  Add an avatar###figure.add", (-1, 0)):
        recent.look()
        imgui.open_popup("add avatar")
    widgets.tooltip("Beside the others: each has its own pose, timeline and place")
    imgui.end_disabled()
    if not imgui.begin_popup("add avatar"):
        return
    there = dict.fromkeys((*(figure.avatar for figure in state.figures), "default"))
    for name in there:
        if imgui.menu_item(f"{plain(os.path.basename(name))}###figure.add.{name}", "", False)[0]:
            if any(figure.avatar == name for figure in state.figures):
                yield AddFigure(name)
            else:
                add(name)
    for path in (path for path in recent.paths if path.endswith(".avatar") and path not in there):
        if imgui.menu_item(f"{os.path.basename(path)}##{path}", "", False, path not in recent.gone)[0]:
            add(path)
    imgui.separator()
    if imgui.menu_item("Open a file…###figure.add.other", "", False)[0]:
        yield action("figure.add")
    imgui.end_popup()


def _place(place: Place) -> Iterator[Command]:
    """Three sliders."""
    for name, title, tip in SLIDERS:
        value, unit = float(getattr(place, name)), units.angle() if name == "turn" else units.length()
        reach = unit.factor * (180.0 if name == "turn" else max(FAR, abs(value) + 1))
        widgets.label(title, LABEL, bool(value))
        new = widgets.slider(f"place.{name}", unit.factor * value, (-reach, reach), unit.form)
        widgets.tooltip(tip)
        if new is not None:
            yield PlaceFigure(replace(place, **{name: new / unit.factor}))
