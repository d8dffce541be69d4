"""The rows of the Timeline: a ruler, a row for each layer with its clip or its keys, a row for each track of one that is open.

The layer that lies over all others is at the top. Keys are diamonds (squares: step; lighter: linear); a line is where the playhead is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.timescale import Timescale
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.keys import CLOSE, LINEAR, STEP, Key, Place, Track
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.timeline import Layer, Timeline
from avatarrex_studio.session.timeline_commands import DeleteKeys, MoveKeys, SetFrame, SetLayer, SetTimeline
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

RULER, ROW = 20.0, 22.0
"""Heights, points."""
NAMES = (110.0, 210.0)
"""Width of the column of names, points: at least and at most."""
BAR = 12.0
"""Points at the right for the scrollbar."""
NEAR = 6.0
"""Points from a key's middle at which it is caught."""
DENSE = 4.0
"""Points between keys under which they are drawn as a bar."""
COLOURS = {"clip": theme.CLIP, "keys": theme.KEYS, "live": theme.LIVE}


@dataclass(frozen=True)
class Grabbed:
    """What the mouse drags: the playhead, an end of the range, a clip, keys, or a frame around keys."""

    what: str
    layer: str = ""
    at: float = 0.0
    """Seconds where it began."""
    before: float = 0.0
    """The clip's offset then."""
    places: tuple[Place, ...] = ()
    track: str | None = None


def kind_of(layer: Layer) -> str:
    """`clip`, `keys` or `live`."""
    return "clip" if layer.clip else "live" if layer.feed else "keys"


class Lanes:
    """Draws the rows; what is selected and which part of time is shown is its own."""

    def __init__(self) -> None:
        self.layer = ""
        """The name of the layer that is selected."""
        self.selected: frozenset[Place] = frozenset()
        """Keys of that layer."""
        self.opened: set[str] = set()
        """Layers whose tracks are shown."""
        self.in_frames = False
        self.missing: frozenset[str] = frozenset()
        """Layers whose files could not be read."""
        self.listening: frozenset[str] = frozenset()
        """Layers that are listened for."""
        self.switched = ""
        """The live layer whose icon was pressed."""
        self.menu = ""
        """The popup to open: `layer`, `keys` or `ruler`."""
        self.pointed = 0.0
        """Seconds under the mouse when a menu was opened."""
        self._shown: tuple[float, float] | None = None
        """Start and seconds that are shown; None: all."""
        self._grabbed: Grabbed | None = None
        self._scale = Timescale(0, 1, 0, 1)

    def draw(self, state: StudioState) -> Iterator[Command]:
        """Draw ruler and rows; the commands of this frame."""
        timeline = state.timeline
        self._forget_what_is_gone(timeline)
        column = min(max(0.32 * widgets.room(), NAMES[0]), NAMES[1])
        place, width = imgui.get_cursor_screen_pos(), widgets.room()
        left = place.x + column
        scale = Timescale.of_all(left, max(width - column - BAR, 50.0), (state.frames - 1) / timeline.fps or 1.0)
        shown = self._shown or (scale.start, scale.seconds)
        if self._grabbed:  # what is dragged beyond the end does not change the scale under the mouse
            shown = self._scale.start, self._scale.seconds
        self._scale = replace(scale, start=shown[0], seconds=shown[1])
        self._ruler(state, place, column)
        imgui.push_style_var(imgui.StyleVar_.item_spacing, (6, 0))
        imgui.push_style_var(imgui.StyleVar_.window_padding, (0, 0))
        flags = imgui.WindowFlags_.no_scroll_with_mouse if imgui.get_io().key_ctrl else 0
        if imgui.begin_child("rows", (0, 0), 0, flags):
            yield from self._rows(state, column)
        self._zoom_by_wheel()
        imgui.end_child()
        imgui.pop_style_var(2)
        yield from self._drag(state)
        here = imgui.is_window_focused(imgui.FocusedFlags_.child_windows) and not imgui.get_io().want_text_input
        if here and self.selected and imgui.is_key_pressed(imgui.Key.delete, False):
            yield DeleteKeys(self.layer, tuple(sorted(self.selected)))
            self.selected = frozenset()

    def show_all(self) -> None:
        """The whole length again."""
        self._shown = None

    def _forget_what_is_gone(self, timeline: Timeline) -> None:
        names = {layer.name for layer in timeline.layers}
        if self.layer not in names:
            self.layer, self.selected = "", frozenset()
        self.opened &= names
        if self.selected and not self._grabbed:
            layer = timeline.layer(self.layer)
            there = {(track.name, key.time) for track in layer.tracks for key in track.keys}
            self.selected &= there

    def _ruler(self, state: StudioState, place: imgui.ImVec2, column: float) -> None:
        """Ticks and the playhead; the time under the mouse becomes the playhead's while it is pressed."""
        timeline, scale, draw = state.timeline, self._scale, imgui.get_window_draw_list()
        where = f"{timeline.frame} / {state.frames - 1}"
        room = column - imgui.calc_text_size(where).x - 16
        where += f"   {timeline.seconds:.2f} s" if room > 60 else ""
        imgui.align_text_to_frame_padding()
        widgets.caption(where, theme.TEXT)
        widgets.tooltip(f"Frame and last frame, {timeline.fps:g} a second")
        imgui.set_cursor_screen_pos((scale.left, place.y))
        imgui.invisible_button("ruler", (scale.width, RULER))
        hovered, low = imgui.is_item_hovered(), imgui.get_item_rect_min()
        high = imgui.get_item_rect_max()
        draw.add_rect_filled(low, high, theme.colour(theme.FRAME), 2.0)
        draw.push_clip_rect(low, high, True)
        for time, text in scale.ticks(timeline.fps, self.in_frames):
            x = round(scale.x(time)) + 0.5
            draw.add_line((x, high.y - (7 if text else 3)), (x, high.y), theme.colour(theme.MUTED, 0.8))
            if text and x + 3 + imgui.calc_text_size(text).x <= high.x:
                draw.add_text((x + 3, low.y + 1), theme.colour(theme.MUTED), text)
        first, last = (scale.x(frame / timeline.fps) for frame in state.played)
        for x, side in ((first, 1), (last, -1)):
            colour = theme.colour(theme.ACCENT if timeline.span else theme.MUTED, 0.9)
            draw.add_triangle_filled((x, high.y), (x, high.y - 8), (x + 7 * side, high.y), colour)
        _head(draw, scale.x(timeline.seconds), low.y, high.y)
        draw.pop_clip_rect()
        mouse = imgui.get_mouse_pos().x
        if imgui.is_item_activated():
            if timeline.span and abs(mouse - first) < NEAR and abs(scale.x(timeline.seconds) - first) > NEAR:
                self._grabbed = Grabbed("start")
            elif timeline.span and abs(mouse - last) < NEAR and abs(scale.x(timeline.seconds) - last) > NEAR:
                self._grabbed = Grabbed("end")
            else:
                self._grabbed = Grabbed("head")
        if hovered and imgui.is_mouse_clicked(imgui.MouseButton_.right):
            self.menu, self.pointed = "ruler", scale.time(mouse)
        if hovered and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            self.show_all()
        if hovered and imgui.get_io().mouse_wheel:
            self._zoom()

    def _rows(self, state: StudioState, column: float) -> Iterator[Command]:
        timeline, draw, scale = state.timeline, imgui.get_window_draw_list(), self._scale
        top = imgui.get_cursor_screen_pos()
        for layer in reversed(timeline.layers):
            imgui.push_id(layer.name)
            yield from self._layer(layer, column)
            if layer.name in self.opened:
                for track in layer.tracks:
                    self._track(layer, track, column)
            imgui.pop_id()
        if not timeline.layers:  # no rows: neither range nor playhead crosses the words
            imgui.set_cursor_pos((8, 8))
            widgets.paragraph(
                "Nothing here yet: choose a motion, open or drop a file, or press K to set a key of the pose."
            )
            return
        bottom = imgui.get_window_pos().y + imgui.get_window_size().y
        draw.push_clip_rect((scale.left, top.y - 4000), (scale.left + scale.width, bottom), True)
        shade = theme.colour(theme.UNREACHED, 0.65)
        window = imgui.get_window_pos().y
        first, last = (scale.x(frame / timeline.fps) for frame in state.played)
        if timeline.span:
            draw.add_rect_filled((scale.left, window), (first, bottom), shade)
            draw.add_rect_filled((last, window), (scale.left + scale.width, bottom), shade)
        x = round(scale.x(timeline.seconds)) + 0.5
        draw.add_line((x, window), (x, bottom), theme.colour(theme.ACCENT), 1.5)
        draw.pop_clip_rect()

    def _layer(self, layer: Layer, column: float) -> Iterator[Command]:
        """The row of a layer: caret or icon, name, whether it is muted, weight, and its lane."""
        start, kind = imgui.get_cursor_screen_pos(), kind_of(layer)
        if layer.name == self.layer:
            draw = imgui.get_window_draw_list()
            draw.add_rect_filled(start, (start.x + column - 3, start.y + ROW), theme.colour(theme.ACCENT, 0.16), 3.0)
        opened = layer.name in self.opened
        mark = {"clip": icons.ICON_FA_FILM, "live": icons.ICON_FA_TOWER_BROADCAST}.get(
            kind, icons.ICON_FA_CARET_DOWN if opened else icons.ICON_FA_CARET_RIGHT
        )
        if _bare_button(f"{mark}###open", start, 20, theme.LIVE if layer.live in self.listening else theme.MUTED):
            self.opened ^= {layer.name} if kind == "keys" else set()
            self.switched = layer.name if kind == "live" else ""
        if kind == "live":
            widgets.tooltip("Stop listening" if layer.live in self.listening else "Listen")
        weight = 40.0 if column > 150 else 0.0
        name_width = column - 20 - 22 - weight - 8
        imgui.set_cursor_screen_pos((start.x + 20, start.y))
        if imgui.invisible_button("name", (max(name_width, 20), ROW)):
            self._choose(layer)
        if imgui.is_item_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.right):
            self._choose(layer)
            self.menu = "layer"
        if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            self.menu = "layer"
        widgets.tooltip(f"{about(layer)}\nRight click: its settings")
        gone = layer.name in self.missing
        tint = theme.ERROR if gone else theme.MUTED if layer.muted else theme.TEXT
        _clipped(layer.name + (" (no file)" if gone else ""), start.x + 22, start.y, name_width, tint)
        if weight:
            imgui.set_cursor_screen_pos((start.x + column - 22 - weight - 4, start.y + 1))
            imgui.set_next_item_width(weight)
            imgui.push_style_var(imgui.StyleVar_.frame_padding, (3, 2))
            changed, share = imgui.drag_float(
                "##weight", 100 * layer.weight, 0.5, 0.0, 100.0, "%.0f%%", imgui.SliderFlags_.clamp_on_input
            )
            imgui.pop_style_var()
            widgets.tooltip("How much of this layer counts: drag, or Ctrl+click to type")
            if changed:
                yield SetLayer(layer.name, weight=share / 100)
        eye = icons.ICON_FA_EYE_SLASH if layer.muted else icons.ICON_FA_EYE
        if _bare_button(
            f"{eye}###mute",
            imgui.ImVec2(start.x + column - 24, start.y),
            22,
            theme.WARNING if layer.muted else theme.MUTED,
        ):
            yield SetLayer(layer.name, muted=not layer.muted)
        widgets.tooltip("Muted" if layer.muted else "Mute")
        self._lane(layer, None, start.y)

    def _track(self, layer: Layer, track: Track, column: float) -> None:
        """The row of one track's keys."""
        start = imgui.get_cursor_screen_pos()
        _clipped(words(track.name).capitalize(), start.x + 30, start.y, column - 36, theme.MUTED)
        imgui.push_id(track.name)
        self._lane(layer, track, start.y)
        imgui.pop_id()

    def _lane(self, layer: Layer, track: Track | None, y: float) -> None:
        """What a row shows over time, and what the mouse does with it."""
        scale, draw = self._scale, imgui.get_window_draw_list()
        imgui.set_cursor_screen_pos((scale.left, y))
        imgui.invisible_button("lane", (scale.width, ROW))
        low, high = imgui.ImVec2(scale.left, y), imgui.ImVec2(scale.left + scale.width, y + ROW - 2)
        draw.push_clip_rect(low, high, True)
        draw.add_rect_filled(low, high, theme.colour(theme.UNREACHED if track else theme.FRAME, 0.55), 2.0)
        alpha = 0.35 if layer.muted else 1.0
        if layer.clip:
            self._clip(draw, layer, y, alpha)
        elif layer.feed:
            off = ", nothing comes" if layer.live in self.listening else ", switched off"
            text = f"live: {layer.feed.source}" + ("" if layer.feed.presence else off)
            draw.add_text((scale.left + 6, y + 2), theme.colour(theme.LIVE, alpha), text)
        else:
            self._keys(draw, layer, track, y)
        draw.pop_clip_rect()
        if imgui.is_item_activated():
            self._press(layer, track)
        if imgui.is_item_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.right):
            if (place := self._under(layer, track)) and not set(place) <= self.selected:
                self._choose(layer)
                self.selected = frozenset(place)
            self._choose(layer)
            self.menu, self.pointed = ("keys" if layer.keyed else "layer"), scale.time(imgui.get_mouse_pos().x)
        imgui.set_cursor_screen_pos((imgui.get_window_pos().x, y + ROW))
        imgui.dummy((0, 0))

    def _clip(self, draw: imgui.ImDrawList, layer: Layer, y: float, alpha: float) -> None:
        """A bar from its beginning to its end; where it repeats, fainter ones after it."""
        scale, (start, end) = self._scale, layer.seconds
        length, right = end - start, scale.time(scale.left + scale.width)
        for n in range(200 if layer.loop else 1):
            if start + n * length > right:
                break
            a, b = scale.x(start + n * length), scale.x(start + (n + 1) * length)
            draw.add_rect_filled(
                (a, y + 1), (b - 1, y + ROW - 3), theme.colour(theme.CLIP, alpha * (0.4 if n else 0.85)), 4.0
            )
        text = layer.name if layer.rate == 1 else f"{layer.name}  × {layer.rate:g}"
        draw.add_text((max(scale.x(start), scale.left) + 6, y + 2), theme.colour(theme.TEXT, alpha), text)

    def _keys(self, draw: imgui.ImDrawList, layer: Layer, track: Track | None, y: float) -> None:
        """Diamonds; of a whole layer one where any track has a key."""
        scale, middle, last = self._scale, y + ROW / 2 - 1, -1e9
        if layer.tracks:
            a, b = (scale.x(time) for time in (track_ends(layer, track) if track else layer.seconds))
            draw.add_line((a, middle), (b, middle), theme.colour(theme.KEYS, 0.35), 2.0)
        for time, key in shown_keys(layer, track):
            x = scale.x(layer.on_timeline(time))
            if not scale.left - NEAR <= x <= scale.left + scale.width + NEAR:
                continue
            chosen = layer.name == self.layer and any(
                abs(time - at) < CLOSE and track in (None, layer.track(name)) for name, at in self.selected
            )
            if x - last < DENSE and not chosen:
                draw.add_line((last, middle), (x, middle), theme.colour(theme.KEYS, 0.8), 4.0)
            else:
                _diamond(
                    draw,
                    x,
                    middle,
                    key.curve if track else "",
                    theme.TEXT if chosen else theme.KEYS,
                    0.4 if layer.muted else 1.0,
                )
            last = x

    def _under(self, layer: Layer, track: Track | None) -> tuple[Place, ...]:
        """The keys under the mouse, of a layer's row those of all tracks."""
        if not layer.keyed:
            return ()
        mouse, scale = imgui.get_mouse_pos().x, self._scale
        near = [
            (abs(scale.x(layer.on_timeline(key.time)) - mouse), key.time)
            for each in ((track,) if track else layer.tracks)
            for key in each.keys
        ]
        if not near or min(near)[0] > NEAR:
            return ()
        time = min(near)[1]
        return tuple(
            (each.name, key.time)
            for each in ((track,) if track else layer.tracks)
            for key in each.keys
            if abs(key.time - time) < CLOSE
        )

    def _choose(self, layer: Layer) -> None:
        if layer.name != self.layer:
            self.layer, self.selected = layer.name, frozenset()

    def _press(self, layer: Layer, track: Track | None) -> None:
        """A press in a lane: keys are selected and dragged, a clip is dragged, an empty place begins a frame."""
        self._choose(layer)
        at, name = self._scale.time(imgui.get_mouse_pos().x), track.name if track else None
        if layer.clip:
            start, end = layer.seconds
            if start <= at and (at <= end or layer.loop):
                self._grabbed = Grabbed("clip", layer.name, at, layer.offset)
            return
        places = frozenset(self._under(layer, track))
        if not places:
            self.selected = frozenset()
            self._grabbed = Grabbed("frame", layer.name, at, track=name)
            return
        if imgui.get_io().key_ctrl:
            self.selected ^= places
        elif not places <= self.selected:
            self.selected = places
        self._grabbed = Grabbed("keys", layer.name, at, places=tuple(sorted(self.selected)))

    def _drag(self, state: StudioState) -> Iterator[Command]:
        """What the drag under way does, on whole frames unless Alt is pressed."""
        timeline, grabbed, now = state.timeline, self._grabbed, self._scale.time(imgui.get_mouse_pos().x)
        if grabbed is None:
            return
        free = imgui.get_io().key_alt
        by = now - grabbed.at if free else round((now - grabbed.at) * timeline.fps) / timeline.fps
        if grabbed.what == "head":
            yield SetFrame(state.nearest(round(now * timeline.fps)))
        elif grabbed.what in ("start", "end"):
            yield from _ranged(state, grabbed.what, round(now * timeline.fps))
        elif grabbed.what == "clip" and by:
            yield SetLayer(grabbed.layer, offset=grabbed.before + by)
        elif grabbed.what == "frame":
            self.selected = self._framed(timeline.layer(grabbed.layer), grabbed, now)
        elif grabbed.what == "keys" and (by or self.selected != frozenset(grabbed.places)):
            own = by * timeline.layer(grabbed.layer).rate
            self.selected = frozenset((name, time + own) for name, time in grabbed.places)
            yield MoveKeys(grabbed.layer, grabbed.places, own)
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._grabbed = None

    def _framed(self, layer: Layer, grabbed: Grabbed, now: float) -> frozenset[Place]:
        """The keys between where the drag began and the mouse, of one track or of all."""
        low, high = sorted((layer.local(grabbed.at), layer.local(now)))
        if self._scale.per_second * (high - low) < 3:
            return frozenset()
        tracks = [track for track in layer.tracks if grabbed.track in (None, track.name)]
        return frozenset((track.name, key.time) for track in tracks for key in track.keys if low <= key.time <= high)

    def _zoom_by_wheel(self) -> None:
        io = imgui.get_io()
        if imgui.is_window_hovered() and (io.key_ctrl or io.key_shift) and (io.mouse_wheel or io.mouse_wheel_h):
            self._zoom()
        if imgui.is_window_hovered() and imgui.is_mouse_dragging(imgui.MouseButton_.middle):
            moved = self._scale.panned(-io.mouse_delta.x)
            self._shown = moved.start, moved.seconds

    def _zoom(self) -> None:
        io = imgui.get_io()
        if io.key_shift:
            moved = self._scale.panned(-60 * (io.mouse_wheel + io.mouse_wheel_h))
        else:
            moved = self._scale.zoomed(0.85**io.mouse_wheel, io.mouse_pos.x)
        self._shown = moved.start, moved.seconds


def about(layer: Layer) -> str:
    """A layer in words."""
    if layer.clip:
        return f"{layer.clip.path}: {layer.clip.frames} frames, {layer.clip.fps:g} a second"
    if layer.feed:
        return f"Live: {layer.feed.source}"
    return f"{sum(len(track.keys) for track in layer.tracks)} keys in {len(layer.tracks)} tracks"


def track_ends(layer: Layer, track: Track) -> tuple[float, float]:
    """Times of the first and the last key, on the timeline."""
    return layer.on_timeline(track.keys[0].time), layer.on_timeline(track.keys[-1].time)


def shown_keys(layer: Layer, track: Track | None) -> list[tuple[float, Key]]:
    """Own times of a track's keys, or of all tracks' keys, each once, in order."""
    if track:
        return [(key.time, key) for key in track.keys]
    keys = {round(key.time / CLOSE): key for each in layer.tracks for key in each.keys}
    return [(key.time, key) for _, key in sorted(keys.items())]


def _ranged(state: StudioState, end: str, frame: int) -> Iterator[Command]:
    first, last = state.played
    ends = {
        "start": (min(max(frame, 0), last - 1), last),
        "end": (first, min(max(frame, first + 1), state.frames - 1)),
    }
    span = ends[end]
    if span != state.timeline.span:
        yield SetTimeline(span=span)


def _head(draw: imgui.ImDrawList, x: float, low: float, high: float) -> None:
    """The playhead's handle on the ruler."""
    colour, x = theme.colour(theme.ACCENT), round(x) + 0.5
    draw.add_rect_filled((x - 5, low), (x + 5, high - 6), colour, 2.0)
    draw.add_triangle_filled((x - 5, high - 6), (x + 5, high - 6), (x, high), colour)


def _diamond(draw: imgui.ImDrawList, x: float, y: float, curve: str, rgb: theme.Rgb, alpha: float) -> None:
    """A square for a step; a diamond else, hollow in the middle where it is linear."""
    colour, size = theme.colour(rgb, alpha), 5.5
    if curve == STEP:
        draw.add_rect_filled((x - 4, y - 4), (x + 4, y + 4), colour, 1.0)
        return
    corners = ((x - size, y), (x, y - size), (x + size, y), (x, y + size))
    draw.add_quad_filled(*corners, colour)
    draw.add_quad(*corners, theme.colour(theme.PANEL, 0.9))
    if curve == LINEAR:
        draw.add_circle_filled((x, y), 1.8, theme.colour(theme.PANEL))


def _bare_button(label: str, place: imgui.ImVec2, width: float, rgb: theme.Rgb) -> bool:
    """An icon without a frame."""
    imgui.set_cursor_screen_pos(place)
    imgui.push_style_color(imgui.Col_.button, theme.vec4(theme.PANEL, 0.0))
    imgui.push_style_color(imgui.Col_.text, theme.vec4(rgb))
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (0, 2))
    pressed: bool = imgui.button(label, (width, ROW - 2))
    imgui.pop_style_var()
    imgui.pop_style_color(2)
    return pressed


def _clipped(text: str, x: float, y: float, width: float, rgb: theme.Rgb) -> None:
    """A text in a row, cut where it does not fit."""
    draw = imgui.get_window_draw_list()
    draw.push_clip_rect((x, y), (x + width, y + ROW), True)
    draw.add_text((x, y + 2), theme.colour(rgb), text)
    draw.pop_clip_rect()
