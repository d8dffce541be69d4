"""The time curve of a clip: a click adds a point, a drag moves it, a right click takes it away."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.time_warp import APART, MOST, WARPS, Warp, warped
from avatarrex_studio.session.timeline import Layer
from avatarrex_studio.session.timeline_commands import SetLayer
from imgui_bundle import imgui

HEIGHT, NEAR, SAMPLES = 96.0, 9.0, 64
"""Points of the screen: its height, and from a point at which it is caught; lines of the curve."""
TIP = "Click: add a point. Drag: move it. Right click: remove it. Across: time; up: place in the file"


class WarpEditor:
    """Which point is dragged is its own."""

    def __init__(self) -> None:
        self._taken: int | None = None

    def draw(self, layer: Layer, width: float) -> Iterator[Command]:
        """Draw it for a clip's layer; the commands of this frame."""
        widgets.caption("Time curve")
        for title, warp in widgets.in_rows(WARPS.items(), columns=3):
            if imgui.small_button(title) and warp != layer.warp:
                yield SetLayer(layer.name, warp=warp)
        low = imgui.get_cursor_screen_pos()
        imgui.invisible_button("warp", (width, HEIGHT))
        widgets.tooltip(TIP)
        mouse = imgui.get_mouse_pos()
        place = ((mouse.x - low.x) / width, 1 - (mouse.y - low.y) / HEIGHT)
        pixels = [((x - place[0]) * width, (y - place[1]) * HEIGHT) for x, y in layer.warp]
        near = next((k for k, (x, y) in enumerate(pixels) if np.hypot(x, y) < NEAR), None)
        self._paint(layer.warp, low, width, near if imgui.is_item_hovered() else self._taken)
        changed = self._changed(layer.warp, place, near)
        if changed is not None and changed != layer.warp:
            yield SetLayer(layer.name, warp=changed)

    def _changed(self, warp: Warp, place: tuple[float, float], near: int | None) -> Warp | None:
        """The curve after what the mouse does."""
        if imgui.is_item_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.right) and near is not None:
            self._taken = None
            return warp[:near] + warp[near + 1 :]
        if imgui.is_item_activated():
            added = with_point(warp, place) if near is None else None
            self._taken = near if added is None else sum(time < place[0] for time, _ in warp)
            return added
        if self._taken is None or not imgui.is_item_active() or self._taken >= len(warp):  # it may have been undone
            self._taken = None
            return None
        return moved(warp, self._taken, place) if imgui.is_mouse_dragging(imgui.MouseButton_.left) else None

    def _paint(self, warp: Warp, low: imgui.ImVec2, width: float, near: int | None) -> None:
        pen, high = imgui.get_window_draw_list(), low + imgui.ImVec2(width, HEIGHT)
        pen.add_rect_filled(low, high, theme.colour(theme.FRAME), 3.0)
        pen.add_line((low.x, high.y), (high.x, low.y), theme.colour(theme.MUTED, 0.4))
        shares = np.linspace(0, 1, SAMPLES + 1)
        line = [
            imgui.ImVec2(low.x + x * width, high.y - y * HEIGHT)
            for x, y in zip(shares.tolist(), warped(warp, shares).tolist())
        ]
        for one, other in itertools.pairwise(line):
            pen.add_line(one, other, theme.colour(theme.CLIP), 2.0)
        for k, (x, y) in enumerate(warp):
            colour = theme.colour(theme.TEXT if k == near else theme.ACCENT)
            pen.add_circle_filled((low.x + x * width, high.y - y * HEIGHT), 5.0, colour)


def with_point(warp: Warp, place: tuple[float, float]) -> Warp | None:
    """With one more; None where there is no room for it."""
    times = [0.0, *(time for time, _ in warp), 1.0]
    if len(warp) >= MOST or min(abs(time - place[0]) for time in times) < APART:
        return None
    return tuple(sorted((*warp, (place[0], min(max(place[1], 0.0), 1.0)))))


def moved(warp: Warp, number: int, place: tuple[float, float]) -> Warp:
    """With one of them elsewhere, between its neighbours."""
    times = [0.0, *(time for time, _ in warp), 1.0]
    time = min(max(place[0], times[number] + APART), times[number + 2] - APART)
    return (*warp[:number], (time, min(max(place[1], 0.0), 1.0)), *warp[number + 1 :])
