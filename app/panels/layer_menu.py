"""Popups of the Timeline: a layer's settings, its keys, the ruler, and how much of all layers each group follows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.lanes import Lanes
from avatarrex_studio.panels.live_menu import LiveMenu
from avatarrex_studio.panels.warp_editor import WarpEditor
from avatarrex_studio.session import keys as curves
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.thinning import redundant
from avatarrex_studio.session.timeline import GROUPS, LONGEST_SMOOTHING, PARTS, Layer, Timeline
from avatarrex_studio.session.timeline_commands import (
    DeleteKeys,
    MoveLayer,
    RemoveLayer,
    RenameLayer,
    SetCurve,
    SetKeys,
    SetLayer,
    SetShare,
    SetTimeline,
)
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

LABEL, WIDTH = 84.0, 300.0
RATES = (24.0, 25.0, 30.0, 50.0, 60.0, 120.0)
"""Frames a second to choose from."""
Copied = tuple[tuple[str, float, tuple[float, ...], str], ...]


class LayerMenu:
    """The popups; what was copied, and a name that is being typed, are its own."""

    def __init__(self) -> None:
        self.copied: Copied = ()
        """Keys, their times since the first of them."""
        self.live, self.warp = LiveMenu(), WarpEditor()
        self._name = ""

    def draw(self, studio: Studio, lanes: Lanes) -> Iterator[Command]:
        """Open the popup that the lanes want, draw those that are open; the commands of this frame."""
        timeline = studio.state.timeline
        lanes.listening = frozenset(studio.listening.drives)
        if lanes.switched:
            self.live.switch(studio, timeline.layer(lanes.switched))
            lanes.switched = ""
        if lanes.menu:
            imgui.open_popup(f"{lanes.menu} menu")
            self._name, lanes.menu = lanes.layer, ""
        chosen = next((layer for layer in timeline.layers if layer.name == lanes.layer), None)
        if imgui.begin_popup("layer menu"):
            if chosen:
                yield from self._layer(chosen, timeline)
                self.live.draw(studio, chosen)
            imgui.end_popup()
        if imgui.begin_popup("keys menu"):
            if chosen:
                yield from self._keys(chosen, timeline, lanes)
            imgui.end_popup()
        if imgui.begin_popup("ruler menu"):
            yield from _ruler(studio.state, lanes)
            imgui.end_popup()

    def _layer(self, layer: Layer, timeline: Timeline) -> Iterator[Command]:
        """Name, what it drives, weight and times."""
        enter = imgui.InputTextFlags_.enter_returns_true
        imgui.set_next_item_width(WIDTH)
        entered, self._name = imgui.input_text("##layer.name", self._name, enter)
        if entered and self._name.strip() and self._name != layer.name:
            yield RenameLayer(layer.name, self._name)
            imgui.close_current_popup()
        widgets.caption("Drives")
        imgui.same_line(LABEL)
        if imgui.small_button("All"):
            yield SetLayer(layer.name, parts=tuple(PARTS))
        imgui.same_line()
        if imgui.small_button("None"):
            yield SetLayer(layer.name, parts=())
        for part in widgets.in_rows(PARTS, columns=3):
            imgui.set_cursor_pos_x(10 + 100 * (list(PARTS).index(part) % 3))
            toggled, driven = imgui.checkbox(f"{part.capitalize()}##part", part in layer.parts)
            if toggled:
                yield SetLayer(layer.name, parts=tuple(layer.parts | {part} if driven else layer.parts - {part}))
        imgui.spacing()
        yield from _numbers(layer)
        if layer.clip:
            yield from self.warp.draw(layer, WIDTH)
        imgui.separator()
        place = timeline.layers.index(layer)
        if imgui.menu_item("Move up", "", False, place < len(timeline.layers) - 1)[0]:
            yield MoveLayer(layer.name, 1)
        if imgui.menu_item("Move down", "", False, place > 0)[0]:
            yield MoveLayer(layer.name, -1)
        if imgui.menu_item("Remove the layer", "", False)[0]:
            yield RemoveLayer(layer.name)

    def _keys(self, layer: Layer, timeline: Timeline, lanes: Lanes) -> Iterator[Command]:
        """What can be done with the selected keys."""
        places = tuple(sorted(lanes.selected))
        widgets.caption(f"{len(places)} selected" if places else "No key selected")
        for curve in curves.CURVES:
            if imgui.menu_item(f"{curve.capitalize()} to the next key", "", False, bool(places))[0]:
                yield SetCurve(layer.name, places, curve)
        imgui.separator()
        if imgui.menu_item("Copy", "", False, bool(places))[0]:
            self.copied = copied(layer, places)
        if imgui.menu_item("Paste at the playhead", "", False, bool(self.copied))[0]:
            start = layer.local(timeline.key_seconds)
            yield SetKeys(
                layer.name, tuple((name, start + time, value, curve) for name, time, value, curve in self.copied)
            )
        if imgui.menu_item("Select all", "", False, bool(layer.tracks))[0]:
            lanes.selected = frozenset((track.name, key.time) for track in layer.tracks for key in track.keys)
        if imgui.menu_item("Thin out", "", False, bool(places))[0] and (gone := redundant(layer.tracks, places)):
            yield DeleteKeys(layer.name, gone)
        widgets.tooltip(
            "Remove recorded keys that the others say, too, within half a degree, a hundredth of a coefficient and 2 mm"
        )
        if imgui.menu_item("Delete", "Del", False, bool(places))[0]:
            yield DeleteKeys(layer.name, places)
        imgui.separator()
        if imgui.begin_menu("Layer"):
            yield from self._layer(layer, timeline)
            imgui.end_menu()


def copied(layer: Layer, places: tuple[curves.Place, ...]) -> Copied:
    """The keys at some places, their times since the first of them."""
    found = curves.found(layer.tracks, places)
    first = min((key.time for keys in found.values() for key in keys), default=0.0)
    return tuple((name, key.time - first, key.value, key.curve) for name, keys in found.items() for key in keys)


def _numbers(layer: Layer) -> Iterator[Command]:
    """Weight, beginning, speed and smoothing as sliders."""
    widgets.label("Weight", LABEL, layer.weight != 1)
    value = widgets.slider("layer.weight", layer.weight, (0.0, 1.0), "%.2f", WIDTH - LABEL, rest=1.0)
    if value is not None:
        yield SetLayer(layer.name, weight=value)
    if layer.feed:
        return
    widgets.label("Begins at", LABEL, layer.offset != 0)
    value = widgets.slider("layer.offset", layer.offset, (-30.0, 30.0), "%.2f s", WIDTH - LABEL)
    if value is not None:
        yield SetLayer(layer.name, offset=value)
    widgets.label("Speed", LABEL, layer.rate != 1)
    value = widgets.slider("layer.rate", layer.rate, (0.1, 4.0), "× %.2f", WIDTH - LABEL, rest=1.0)
    if value is not None:
        yield SetLayer(layer.name, rate=value)
    toggled, loop = imgui.checkbox("Repeat", layer.loop)
    if toggled:
        yield SetLayer(layer.name, loop=loop)
    if layer.clip:
        widgets.label("Smoothing", LABEL, layer.smoothing != 0)
        value = widgets.slider(
            "layer.smoothing", layer.smoothing, (0.0, LONGEST_SMOOTHING / 2), "%.2f s", WIDTH - LABEL
        )
        widgets.tooltip("Average over neighbouring frames, weighted by a Gaussian of this width")
        if value is not None:
            yield SetLayer(layer.name, smoothing=value)


def _ruler(state: StudioState, lanes: Lanes) -> Iterator[Command]:
    """The range, the rate, and what the ruler counts."""
    timeline, (first, last) = state.timeline, state.played
    frame = state.nearest(round(lanes.pointed * timeline.fps))
    if imgui.menu_item(f"Play from frame {frame}", "", False, frame < last)[0]:
        yield SetTimeline(span=(frame, last))
    if imgui.menu_item(f"Play up to frame {frame}", "", False, frame > first)[0]:
        yield SetTimeline(span=(first, frame))
    if imgui.menu_item("Play all", "", False, timeline.span is not None)[0]:
        yield SetTimeline(span=())
    imgui.separator()
    if imgui.menu_item("Count frames", "", lanes.in_frames)[0]:
        lanes.in_frames = not lanes.in_frames
    if imgui.menu_item("Show all", "", False)[0]:
        lanes.show_all()
    if imgui.begin_menu("Frames a second"):
        for rate in sorted({*RATES, timeline.fps}):
            if imgui.menu_item(f"{rate:g}", "", rate == timeline.fps)[0]:
                yield SetTimeline(fps=rate)
        imgui.end_menu()


def shares(timeline: Timeline) -> Iterator[Command]:
    """The popup of groups: each can be muted, or follow all layers in part."""
    if not imgui.begin_popup("groups"):
        return
    widgets.caption("How much of all layers each part follows; the rest is as you pose it")
    for group in GROUPS:
        share = timeline.share(group)
        imgui.push_id(group)
        imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.WARNING if share.muted else theme.MUTED))
        if imgui.button(f"{icons.ICON_FA_EYE_SLASH if share.muted else icons.ICON_FA_EYE}###mute", (28, 0)):
            yield SetShare(group, replace(share, muted=not share.muted))
        imgui.pop_style_color()
        imgui.same_line()
        widgets.label(group.capitalize(), LABEL + 36, share.of_layers != 1)
        value = widgets.slider("share", share.weight, (0.0, 1.0), "%.2f", WIDTH - LABEL, rest=1.0)
        if value is not None:
            yield SetShare(group, replace(share, weight=value))
        imgui.pop_id()
    imgui.end_popup()
