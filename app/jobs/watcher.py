"""Runs and their pictures read in a thread of its own, so that whoever draws never waits for a file."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from pathlib import Path

import numpy as np
from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.runs import DEPTH, Runs
from jaxtyping import UInt8
from PIL import Image

log = logging.getLogger(__name__)
POLL_SECONDS, RESTING_SECONDS = 0.5, 2.0
"""Between two looks, and where there is no run."""
PICTURES = 48
"""Decoded pictures that are kept."""


class Watcher(threading.Thread):
    """Reads the runs below a folder, and pictures on request, until closed."""

    def __init__(self, folder: str | Path) -> None:
        super().__init__(name="watcher", daemon=True)
        self.folder = Path(folder)
        self.views: tuple[RunView, ...] = ()
        """The runs as they were last read; replaced, never changed."""
        self.others: tuple[Path, ...] = ()
        """Runs elsewhere that are read, too."""
        self._wake, self._closed = threading.Event(), False
        self._pictures: OrderedDict[tuple[Path, int], UInt8[np.ndarray, "h w 3"] | None] = OrderedDict()
        self._requested: list[tuple[Path, int]] = []

    def run(self) -> None:
        """Read until closed."""
        runs = Runs(self.folder)
        while not self._closed:
            runs.others = self.others
            waiting = runs.poll()
            self.views = runs.views
            while self._requested and not self._closed:
                key = self._requested.pop()
                self._pictures[key] = _decoded(key[0])
                while len(self._pictures) > PICTURES:
                    self._pictures.popitem(last=False)
            if not waiting:
                self._wake.wait(POLL_SECONDS if self.views else RESTING_SECONDS)
            self._wake.clear()

    def picture(self, path: Path) -> UInt8[np.ndarray, "h w 3"] | None:
        """The picture in a file once it is decoded, sRGB bytes; None until then, and for a broken one."""
        try:
            key = (path, path.stat().st_mtime_ns)
        except OSError:
            return None
        found = self._pictures.get(key, key)
        if not isinstance(found, tuple):
            return found
        if key not in self._requested:
            self._requested.append(key)
            self._wake.set()
        return None

    def include(self, run: Path) -> Path:
        """Read a run, wherever it lies; its path in `views`."""
        place, top = run.resolve(), self.folder.resolve()
        if place.is_relative_to(top) and len(place.relative_to(top).parts) <= DEPTH:
            return self.folder / place.relative_to(top)
        self.others = tuple(dict.fromkeys((*self.others, run)))
        return run

    def look_again(self) -> None:
        """Look now, for a button was pressed."""
        self._wake.set()

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._wake.set()
        if self.is_alive():
            self.join(5)


def _decoded(path: Path) -> UInt8[np.ndarray, "h w 3"] | None:
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:  # what Pillow raises for a broken file
        log.warning("%s: %s", path, error)
        return None
