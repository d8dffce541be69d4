"""All that is switched on, by the layer that it drives; nothing listens unless somebody has switched it on here."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from avatarrex_studio.live.drive import Drive, Sender
from avatarrex_studio.live.receiver import LOOPBACK, Receiver
from avatarrex_studio.live.sources import SOURCES
from avatarrex_studio.session.notice import NOTICE, refusals_logged
from avatarrex_studio.session.timeline import Feeds, Timeline
from avatarrex_studio.session.user_library import library_folder, state_folder

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence, interpolate

log = logging.getLogger(__name__)
LEAST = 2
"""Frames of a recording."""
TAKE_FPS = 60.0
"""Frames a second of a recording."""


class Listening:
    """Switches sources on and off and gives what they drive."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.arrived: Callable[[], None] = lambda: None
        """Called by a thread when something has come: the window wakes."""
        self.drives: dict[str, Drive] = {}
        """By what their layers are listened for as (`Layer.live`)."""
        self._clock = clock

    def switch_on(self, layer: str, source: str, address: str = LOOPBACK, port: int | None = None) -> None:
        """Listen for one of `SOURCES`. Raises `InputError` where the port cannot be had."""
        if source not in SOURCES:
            raise InputError("live", "source", ", ".join(SOURCES), source)
        self.switch_off(layer)
        kind = SOURCES[source]
        number = kind.port if port is None else port
        self.take_up(layer, Receiver(kind.decode, address, number, lambda: self.arrived()))

    def take_up(self, layer: str, sender: Sender) -> None:
        """Have a layer driven by what is there already: a camera, a recording."""
        self.drives[layer] = Drive(sender)

    def switch_off(self, layer: str) -> None:
        """Listen no more for a layer. What was being recorded is kept as a file."""
        drive = self.drives.get(layer)
        if drive is None:
            return
        with refusals_logged():
            if len(drive.take or ()) >= LEAST:
                log.log(NOTICE, "The recording of %s is kept: %s", drive.title, self._kept(layer))
        del self.drives[layer]
        drive.sender.close()

    def close(self) -> None:
        """Switch all off."""
        for layer in list(self.drives):
            self.switch_off(layer)

    @property
    def present(self) -> bool:
        """Whether something drives a layer at present."""
        return any(drive.presence > 0 for drive in self.drives.values())

    @property
    def words(self) -> str:
        """What listens, for the status bar; empty where nothing does."""
        said = []
        for drive in self.drives.values():
            counts = drive.sender.counts
            bad = f", {counts.malformed} malformed" if counts.malformed else ""
            bad += ", recording" if drive.take is not None else ""
            said.append(f"{drive.sender.where} ({counts.rate}/s{bad})")
        return "listening at " + ", ".join(said) if said else ""

    def tick(self, timelines: Iterable[Timeline]) -> bool:
        """Take what came; whether anything drives otherwise than before. What has no layer in any of `timelines` is switched off."""
        for gone in set(self.drives).difference(*(timeline.live for timeline in timelines)):
            self.switch_off(gone)
        now = self._clock()
        changed = [drive.tick(now) for drive in self.drives.values()]
        return any(changed)

    def feeds(self, timeline: Timeline) -> Feeds:
        """Of every live layer: name, signals, presence; as they are where it is switched off."""
        found = []
        for layer in timeline.layers:
            drive = self.drives.get(layer.live) or layer.feed
            if layer.feed and drive:
                found.append((layer.name, drive.signals, drive.presence))
        return tuple(found)

    def record(self, layer: str, title: str, begins: float) -> None:
        """Begin to record what drives a layer, which the user calls `title`, at a second of its timeline."""
        drive = self.drives[layer]
        drive.take, drive.title, drive.begins = [], title, begins

    def recorded(self, layer: str, folder: Path | None = None) -> Path:
        """End the recording; the motion file with it, in `folder` (the user's library).

        Raises `InputError` for an empty one, and where the file cannot be written: then the recording goes on.
        """
        drive = self.drives[layer]
        frames = drive.take or []
        if len(frames) < LEAST:
            drive.take = None
            raise InputError(drive.title, "recording", "two frames or more", len(frames))
        folder = folder or library_folder() / "takes"
        name = time.strftime("take-%Y%m%d-%H%M%S")
        number = sum(1 for _ in folder.glob(f"{name}*.json")) if what_is(folder) == "a folder" else 0
        path = folder / f"{name}{f'-{number + 1}' if number else ''}.json"
        write_json(path, evenly(frames, path.stem))
        drive.take = None
        return path

    def _kept(self, layer: str) -> Path:
        """The file with a recording that ends, in the state's folder where the library takes none. Raises `InputError` where neither does."""
        try:
            return self.recorded(layer)
        except InputError as error:
            log.warning("%s", error)
            return self.recorded(layer, state_folder() / "takes")


def evenly(frames: list[tuple[float, Signals]], name: str, fps: float = TAKE_FPS) -> SignalSequence:
    """Frames of uneven times at an even rate."""
    times = np.array([time for time, _ in frames]) - frames[0][0]
    even = np.arange(int(times[-1] * fps + 1e-9) + 1) / fps
    places = np.clip(np.searchsorted(times, even, side="right") - 1, 0, len(frames) - 2)
    made = []
    for time_, k in zip(even, places):
        share = float(np.clip((time_ - times[k]) / max(times[k + 1] - times[k], 1e-9), 0.0, 1.0))
        made.append(interpolate(frames[k][1], frames[k + 1][1], share))
    return SignalSequence(tuple(made), fps, name)
