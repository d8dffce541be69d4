"""The Timeline: play at its own rate, scrub, repeat, a range; layers, keys and recording; the motions that come with the program."""

from __future__ import annotations

from collections.abc import Iterator

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.live.sources import FACE, SOURCES, WEBCAM
from avatarrex_studio.panels import layer_menu, theme, widgets
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.panels.lanes import Lanes
from avatarrex_studio.panels.motion_import import MotionImport, MotionReader, without_options
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.take import NAME
from avatarrex_studio.session.timeline import Feed, Layer, Timeline
from avatarrex_studio.session.timeline_commands import AddLayer, SetFrame, SetTimeline
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.own_motions import MOTIONS

NARROW = 440.0
"""Points under which the buttons to both ends are left out."""
FIELD = 60.0
"""Points that the field of the path needs."""


class TimelinePanel:
    """Transport and layers, how the motion was read, and the path of the next."""

    def __init__(self, reader: MotionReader) -> None:
        self._reader = reader
        self.reading, self.files = MotionImport(reader), FileDialog()
        self.lanes, self.menu = Lanes(), layer_menu.LayerMenu()
        self._path: tuple[str, str] = ("", "")
        """The path of the loaded motion, and what was typed since."""
        self._frame = -1
        """What is typed to go to; -1: nothing."""

    def draw(self, studio: Studio) -> Iterator[Command]:
        """Draw the panel; the commands of this frame."""
        timeline = studio.state.timeline
        imgui.push_style_var(imgui.StyleVar_.item_spacing, (4, 4))
        yield from self._transport(studio, studio.state)
        imgui.same_line()
        self._record(studio)
        imgui.same_line(0, 10)
        yield from self._layers(studio)
        imgui.same_line()
        self._field(studio, timeline)
        imgui.pop_style_var()
        studio.take.layer, self.lanes.missing = self.lanes.layer, studio.clips.missing(timeline)
        yield from self.lanes.draw(studio.state)  # of after the commands above
        yield from self.menu.draw(studio, self.lanes)
        yield from self._go_to(studio.state)
        self.files.draw()

    def go_to(self) -> None:
        """Have a frame typed to go to."""
        self._frame = 0

    def _transport(self, studio: Studio, state: StudioState) -> Iterator[Command]:
        """First frame, one back, play, one on, last frame, repeat."""
        timeline, (first, last) = state.timeline, state.played
        square = (26, 0)
        buttons = {
            "first": (icons.ICON_FA_BACKWARD_FAST, first), "back": (icons.ICON_FA_BACKWARD_STEP, timeline.frame - 1), "play": ("", 0),
            "on": (icons.ICON_FA_FORWARD_STEP, timeline.frame + 1), "last": (icons.ICON_FA_FORWARD_FAST, last),
        }  # fmt: skip
        narrow = widgets.room() < NARROW
        shown = [name for name in buttons if not (narrow and name in ("first", "last"))]
        for name in widgets.in_rows(shown, 3):
            icon, frame = buttons[name]
            if name == "play":
                if imgui.button(
                    f"{icons.ICON_FA_PAUSE if studio.playback.playing else icons.ICON_FA_PLAY}###play", (34, 0)
                ):
                    studio.toggle_play()
            elif imgui.button(f"{icon}##{name}", square):
                yield SetFrame(state.nearest(frame))
        imgui.same_line()
        if _toggle(f"{icons.ICON_FA_REPEAT}##repeat", timeline.loop, theme.ACCENT):
            yield SetTimeline(loop=not timeline.loop)
        widgets.tooltip("Repeat")

    def _record(self, studio: Studio) -> None:
        """Keys: recording, and one of the present pose."""
        if _toggle(f"{icons.ICON_FA_CIRCLE}##record", studio.take.recording, theme.ERROR):
            studio.take.recording = not studio.take.recording
        widgets.tooltip("Record: what you change becomes keys at the playhead, also while it plays")
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_KEY}##key", (26, 0)):
            studio.set_key()
        widgets.tooltip("Set key (K): of what is selected, else of what you changed. Shift+K: of the camera")

    def _layers(self, studio: Studio) -> Iterator[Command]:
        """What a layer can be added from, and what all of them are followed by."""
        self._own(studio)
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_PLUS}  Layer##layer.add"):
            imgui.open_popup("add layer")
        if imgui.begin_popup("add layer"):
            if imgui.menu_item("Keys", "", False)[0]:
                yield AddLayer(Layer(NAME))
            if imgui.menu_item("Motion, face or sound file…", "", False)[0]:
                self.files.open("layer", "Add a layer", self._reader.layer)
            for name, what in MOTIONS.items():
                if imgui.menu_item(f"Motion {name}: {what}", "", False)[0]:
                    studio.add_motion(name)
            imgui.separator()
            live = {source: (kind.title, kind.parts) for source, kind in SOURCES.items()}
            for source, (title, parts) in {**live, WEBCAM: ("Webcam", FACE)}.items():
                if imgui.menu_item(f"Live: {title}", "", False)[0]:
                    name = studio.state.timeline.free_name(title)
                    yield AddLayer(Layer(name, feed=Feed(source), parts=frozenset(parts)))
                    self.lanes.layer, self.lanes.menu = name, "layer"
            imgui.end_popup()
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_SLIDERS}  Parts##groups"):
            imgui.open_popup("groups")
        widgets.tooltip("How much of the layers each part of the body follows")
        yield from layer_menu.shares(studio.state.timeline)

    def _own(self, studio: Studio) -> None:
        """The menu of motions, and how the loaded one was read."""
        if imgui.button(f"{icons.ICON_FA_PERSON_WALKING}  Motions##motion.own"):
            imgui.open_popup("motions")
        if imgui.begin_popup("motions"):
            for name, what in MOTIONS.items():
                if imgui.menu_item(f"{name.capitalize()}: {what}", "", False)[0]:
                    studio.open_motion(name)
            if imgui.menu_item("Open a file…", "", False)[0]:
                self._choose()
            imgui.separator()
            if imgui.menu_item("How the motion was read…", "", False, studio.state.timeline.motion is not None)[0]:
                self.reading.open()
            imgui.end_popup()
        motion = studio.motion
        if motion and motion.imported.warnings:
            imgui.same_line()
            if imgui.button(f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}##motion.warnings"):
                self.reading.open()
            widgets.tooltip("\n".join(map(without_options, motion.imported.warnings)))

    def _field(self, studio: Studio, timeline: Timeline) -> None:
        """The path of the loaded motion, where another can be typed, as far as there is room."""
        if widgets.room() < FIELD + 34:
            imgui.new_line()
            return
        loaded = timeline.motion.path if timeline.motion else ""
        if loaded != self._path[0]:
            self._path = loaded, loaded
        imgui.set_next_item_width(widgets.room() - 34)
        entered, typed = imgui.input_text_with_hint(
            "##motion.path", "Path of a motion file", self._path[1], imgui.InputTextFlags_.enter_returns_true
        )
        self._path = loaded, typed
        if loaded:
            widgets.tooltip(loaded)
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}##motion", (-1, 0)):
            self._choose()
        if entered and typed.strip():
            self._reader.motion(typed.strip())

    def _choose(self) -> None:
        self.files.open("motion", "Open a motion", self._reader.motion)

    def _go_to(self, state: StudioState) -> Iterator[Command]:
        """The popup of *Go to frame*."""
        if self._frame >= 0:
            imgui.open_popup("go to")
            self._frame = -1
        if imgui.begin_popup("go to"):
            widgets.caption("Go to frame")
            if imgui.is_window_appearing():
                imgui.set_keyboard_focus_here()
            imgui.set_next_item_width(120)
            enter = imgui.InputTextFlags_.enter_returns_true
            entered, frame = imgui.input_int("##go.frame", state.timeline.frame, 1, 10, enter)
            if entered:
                yield SetFrame(state.nearest(frame))
                imgui.close_current_popup()
            imgui.end_popup()


def _toggle(label: str, on: bool, rgb: theme.Rgb) -> bool:
    """A button that is lit while it is on; whether it was pressed."""
    imgui.push_style_color(imgui.Col_.text, theme.vec4(rgb if on else theme.MUTED))
    pressed: bool = imgui.button(label, (26, 0))
    imgui.pop_style_color()
    return pressed
