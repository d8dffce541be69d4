"""A capture of another layout on its way into ours: looked at with a few frames first, then imported as was guessed or said.

What is found and decided, and what of the files cannot be used, is the task's text; the template over the pictures is its picture.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from avatarrex_studio.jobs.task import UNUSABLE, Task, beside
from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.files import FileDialog
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.capture.importers.corrections import HANDS, UNITS, UP
from avatarrex.files.gate import what_is

LABEL = 72.0
GUESSED = "guessed"
CHOICES = {"unit": tuple(UNITS), "up": UP, "hands": HANDS}
"""What may be said, by option."""
TITLES = {"unit": "Unit", "up": "Up", "hands": "Hands"}
ABOUT = {
    "unit": "Of the cameras' places",
    "up": "The axis of the file's world that is up",
    "hands": "What fingers at zero, or without parameters, are: flat, or the mean hand that the file has",
}
FRAMES = 3
"""That are looked at: one of them may hide what is wrong with axes, unit or hands, and each takes as long as the next."""


class CaptureImport:
    """What is filled in."""

    def __init__(self, files: FileDialog) -> None:
        """`files`: the panel's dialog, which it draws."""
        self.source, self.out, self.files = "", "", files
        self.said = dict.fromkeys(CHOICES, "")
        """By option; empty: guessed."""

    def choose(self) -> None:
        """Ask for the folder or .zip."""
        self.files.open("capture", "Import a capture", self.take)

    def take(self, source: str) -> None:
        """A source; what was said of another one is forgotten."""
        self.source, self.out, self.said = source, "", dict.fromkeys(CHOICES, "")

    def draw(self) -> Task | None:
        """Draw the fields; the task whose button was pressed."""
        widgets.label("From", LABEL)
        widgets.fill(36)
        _, self.source = imgui.input_text_with_hint(
            "##import.source", "Folder or .zip as it was published", self.source
        )
        imgui.same_line(0, 4)
        if imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}##import", (32, 0)):
            self.choose()
        for name, known in CHOICES.items():
            widgets.label(TITLES[name], LABEL)
            current = self.said[name] or GUESSED
            picked = widgets.choice(f"##import.{name}", (GUESSED, *known), current, current)
            widgets.tooltip(ABOUT[name])
            self.said[name] = "" if (picked or current) == GUESSED else picked or current
        source = os.path.expanduser(self.source.strip())
        hint = beside(str(Path(source)).removesuffix(".zip"), "_imported")
        widgets.label("Into", LABEL)
        _, self.out = imgui.input_text_with_hint("##import.out", hint, self.out)
        out = os.path.expanduser(self.out.strip()) or hint
        pressed = self._buttons(bool(hint) and what_is(source) in ("a file", "a folder"), out)
        if pressed == "look":
            return self.look(source)
        return self.whole(source, out) if pressed else None

    def _buttons(self, there: bool, out: str) -> str | None:
        """Which was pressed, of a source that is `there`."""
        free = beside(out, ".log") and what_is(out) in ("nothing there", "a folder")
        imgui.begin_disabled(not there or not free)
        titles = {"look": f"{icons.ICON_FA_EYE}  Look first", "whole": f"{icons.ICON_FA_FILE_IMPORT}  Import"}
        pressed = widgets.button_grid(titles, 100, "import.")
        imgui.end_disabled()
        return pressed

    def look(self, source: str) -> Task:
        """A few frames in the user's cache, with the template over them."""
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "avatarrex-studio" / "imports"
        folder = cache / hashlib.sha256(os.path.abspath(source).encode()).hexdigest()[:16]
        words = (*self._words(source, str(folder)), "--preview", str(FRAMES))
        pictures = tuple(folder / "look" / f"{rig}.png" for rig in ("body", "face"))
        return Task(
            f"Look at {Path(source).name}", words, folder.with_name(f"{folder.name}.log"), pictures, bad=(UNUSABLE,)
        )

    def whole(self, source: str, out: str) -> Task:
        """All of it; the capture is then filled in for a training."""
        log = Path(beside(out, ".log"))
        return Task(f"Import {Path(source).name}", self._words(source, out), log, capture=out)

    def _words(self, source: str, out: str) -> tuple[str, ...]:
        said = (word for name, value in self.said.items() if value for word in (f"--{name}={value}",))
        return ("capture", "import", source, out, *said)
