"""The settings of a live layer: where it is listened for, what comes, calibration and recording."""

from __future__ import annotations

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.live.receiver import LOOPBACK, Receiver
from avatarrex_studio.live.sources import SOURCES
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.session.notice import refusals_logged
from avatarrex_studio.session.timeline import Feed, Layer
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

LABEL, WIDTH = 84.0, 300.0


class LiveMenu:
    """What is typed for each layer is its own."""

    def __init__(self) -> None:
        self._places: dict[str, tuple[str, int]] = {}
        """Address and port by layer."""
        self._phone = ""

    def switch(self, studio: Studio, layer: str) -> None:
        """Listen for a layer, or no more."""
        if layer in studio.listening.drives:
            studio.listening.switch_off(layer)
            return
        feed = studio.state.timeline.layer(layer).feed
        assert feed is not None
        with refusals_logged():
            studio.listening.switch_on(layer, feed.source, *self._place(layer, feed))

    def draw(self, studio: Studio, layer: Layer) -> None:
        """Draw it inside of the layer's popup."""
        feed, drive = layer.feed, studio.listening.drives.get(layer.name)
        if feed is None or feed.source not in SOURCES:
            return
        source = SOURCES[feed.source]
        address, port = self._place(layer.name, feed)
        imgui.begin_disabled(drive is not None)
        widgets.label("Address", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        _, address = imgui.input_text("##live.address", address)
        widgets.tooltip(f"{LOOPBACK} is this computer alone; 0.0.0.0 is every network: whoever reaches it moves the avatar")
        widgets.label("UDP port", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        _, port = imgui.input_int("##live.port", port, 0, 0)
        imgui.end_disabled()
        self._places[layer.name] = address, port
        if imgui.button("Stop listening###live.switch" if drive else "Listen###live.switch", (WIDTH, 0)):
            self.switch(studio, layer.name)
        if drive is None:
            return
        counts = drive.sender.counts
        widgets.caption(f"{counts.rate} a second, {counts.received} in all, {counts.malformed} malformed, {counts.dropped} dropped")
        half = (WIDTH - 6) / 2
        if imgui.button("Neutral face###live.neutral", (half, 0)):
            drive.calibrate()
        widgets.tooltip("What the face does now is neutral, and where the head looks is straight ahead")
        imgui.same_line(0, 6)
        recording = drive.take is not None
        imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.ERROR if recording else theme.TEXT))
        if imgui.button(f"{icons.ICON_FA_CIRCLE}  {'End the recording' if recording else 'Record'}###live.record", (half, 0)):
            studio.record_live(layer.name)
        imgui.pop_style_color()
        if source.hello and isinstance(drive.sender, Receiver):
            widgets.label("Phone", LABEL)
            imgui.set_next_item_width(WIDTH - LABEL)
            enter = imgui.InputTextFlags_.enter_returns_true
            entered, self._phone = imgui.input_text_with_hint("##live.phone", "Its address, Enter: tell it to send", self._phone, enter)
            if entered and self._phone.strip():
                with refusals_logged():
                    drive.sender.greet(self._phone.strip(), source.hello)

    def _place(self, layer: str, feed: Feed) -> tuple[str, int]:
        source = SOURCES.get(feed.source)
        return self._places.get(layer, (LOOPBACK, source.port if source else 0))
