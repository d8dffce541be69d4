"""The settings of a live layer: where it is listened for, what comes, calibration and recording."""

from __future__ import annotations

from collections.abc import Callable

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.live.drive import Sender
from avatarrex_studio.live.receiver import LOOPBACK, Receiver
from avatarrex_studio.live.replay import RECORDED, Replay
from avatarrex_studio.live.sources import SOURCES, WEBCAM
from avatarrex_studio.live.webcam import EXTRA, Webcam
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
        """Address and port by what a layer is listened for as."""
        self._phone = self._model = ""
        self._camera = "0"

    def switch(self, studio: Studio, layer: Layer) -> None:
        """Listen for a layer, or no more."""
        feed, live = layer.feed, layer.live
        if live in studio.listening.drives:
            studio.listening.switch_off(live)
            return
        assert feed is not None
        with refusals_logged():
            if feed.source == WEBCAM:
                studio.listening.take_up(live, self._watched(lambda: studio.listening.arrived()))
            else:
                studio.listening.switch_on(live, feed.source, *self._place(live, feed))

    def _watched(self, arrived: Callable[[], None]) -> Sender:
        """A camera, a film or recorded landmarks. Raises `InputError`."""
        camera = self._camera.strip()
        return Replay(camera, arrived) if camera.endswith(RECORDED) else Webcam(self._model, camera, arrived)

    def draw(self, studio: Studio, layer: Layer) -> None:
        """Draw it inside of the layer's popup."""
        feed, drive = layer.feed, studio.listening.drives.get(layer.live)
        if feed is None:
            return
        imgui.begin_disabled(drive is not None)
        if feed.source == WEBCAM:
            self._webcam()
        else:
            self._port(layer, feed)
        imgui.end_disabled()
        words = ("Stop", "Start") if feed.source == WEBCAM else ("Stop listening", "Listen")
        if imgui.button(f"{words[drive is None]}###live.switch", (WIDTH, 0)):
            self.switch(studio, layer)
        if drive is None:
            return
        counts = drive.sender.counts
        widgets.caption(
            f"{counts.rate} a second, {counts.received} in all, {counts.malformed} malformed, {counts.dropped} dropped"
        )
        half = (WIDTH - 6) / 2
        if imgui.button("Neutral face###live.neutral", (half, 0)):
            drive.calibrate()
        widgets.tooltip(
            "What the face does now is neutral, and where the head looks is straight ahead; a body (VMC) is in the middle again"
        )
        imgui.same_line(0, 6)
        recording = drive.take is not None
        imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.ERROR if recording else theme.TEXT))
        if imgui.button(
            f"{icons.ICON_FA_CIRCLE}  {'End the recording' if recording else 'Record'}###live.record", (half, 0)
        ):
            studio.record_live(layer.name)
        imgui.pop_style_color()
        if isinstance(drive.sender, Receiver) and SOURCES[feed.source].hello:
            self._greet(drive.sender, SOURCES[feed.source].hello)

    def _port(self, layer: Layer, feed: Feed) -> None:
        """Where it is listened."""
        address, port = self._place(layer.live, feed)
        widgets.label("Address", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        _, address = imgui.input_text("##live.address", address)
        widgets.tooltip(
            f"{LOOPBACK} is this computer alone; 0.0.0.0 is every network: whoever reaches it moves the avatar"
        )
        widgets.label("UDP port", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        _, port = imgui.input_int("##live.port", port, 0, 0)
        self._places[layer.live] = address, port

    def _webcam(self) -> None:
        """The camera's number, or a file, and the landmarker's, which recorded landmarks do not need."""
        widgets.label("Camera", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        _, self._camera = imgui.input_text_with_hint("##live.camera", "0, 1 … or a file", self._camera)
        widgets.tooltip(f"The number of a camera, a film, or recorded landmarks ({RECORDED})")
        imgui.begin_disabled(self._camera.strip().endswith(RECORDED))
        widgets.label("Model file", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        _, self._model = imgui.input_text_with_hint("##live.model", "face_landmarker.task", self._model)
        widgets.tooltip("A face landmarker of mediapipe, which you have downloaded; needs " + EXTRA)
        imgui.end_disabled()

    def _greet(self, receiver: Receiver, words: bytes) -> None:
        """Phones that wait for a word at their port."""
        widgets.label("Phone", LABEL)
        imgui.set_next_item_width(WIDTH - LABEL)
        enter = imgui.InputTextFlags_.enter_returns_true
        entered, self._phone = imgui.input_text_with_hint(
            "##live.phone", "Its address, Enter: tell it to send", self._phone, enter
        )
        if entered and self._phone.strip():
            with refusals_logged():
                receiver.greet(self._phone.strip(), words)

    def _place(self, layer: str, feed: Feed) -> tuple[str, int]:
        source = SOURCES.get(feed.source)
        return self._places.get(layer, (LOOPBACK, source.port if source else 0))
