"""Where the slice lies, over the viewport's upper left: its axis, its place, and of which volume it is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import theme, units, widgets
from avatarrex_studio.panels.export_progress import FLAGS, GAP
from avatarrex_studio.session.commands import Command, MoveCut
from avatarrex_studio.session.cut import AXES
from avatarrex_studio.session.state import SLICE
from imgui_bundle import imgui, imgui_ctx

WIDTH = 240.0
"""Points: beside the person in a narrow viewport."""
REACH = 1.2
"""Metres to either side of the selected figure's pelvis that the slider goes to."""


def draw(studio: Studio, low: tuple[float, float], high: tuple[float, float]) -> Iterator[Command]:
    """Draw it into a rectangle of the screen, where a slice is shown."""
    width = min(WIDTH, high[0] - low[0] - 2 * GAP)
    if studio.state.tools.shows != SLICE or width < 120:
        return
    cut, unit, middle = studio.state.tools.cut, units.length(), pelvis(studio)
    imgui.set_next_window_pos((low[0] + GAP, low[1] + GAP))
    imgui.set_next_window_size_constraints((width, 0), (width, 300))
    with (
        imgui_ctx.push_style_color(imgui.Col_.window_bg, theme.vec4(theme.RAISED, 0.97)),
        imgui_ctx.begin("Slice", None, FLAGS),
    ):
        for axis, title in widgets.in_rows(AXES.items(), 14):
            if imgui.radio_button(f"{title}##{axis}", cut.axis == axis) and cut.axis != axis:
                yield MoveCut(axis, float(middle["xyz".index(axis)]))
        imgui.set_next_item_width(-1)
        low_end, high_end = ((middle[cut.row] + side) * unit.factor for side in (-REACH, REACH))
        moved, place = imgui.slider_float("##place", cut.offset * unit.factor, low_end, high_end, unit.form)
        if moved:
            yield MoveCut(cut.axis, place / unit.factor)
        widgets.paragraph(freshness(studio))


def pelvis(studio: Studio) -> np.ndarray:
    """(3,): of the selected figure, world, metres; the origin while its avatar is read."""
    figure, world = studio.figure, studio.world
    own = np.zeros(3) if figure is None else figure.posed.position[0]
    return np.asarray(world[:3, :3] @ own + world[:3, 3])


def freshness(studio: Studio) -> str:
    """Of which volume the slice is that is on the screen."""
    shown = studio.pictures.shown
    if studio.pictures.error:
        return "There is no slice: the exact picture failed."
    if shown is None or not studio.pictures.covers:
        return "The slice comes with the next exact picture, when nothing moves."
    where = f"Distance to the skin (level {shown.level}): blue outside, orange inside"
    return f"{where}, a line each 1 cm (from far: each 5 cm)."
