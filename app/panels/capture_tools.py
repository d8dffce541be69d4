"""Captures made, imported, checked, refined and matched in exposure: a button for each, and the few things that it needs to know."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import NamedTuple

from avatarrex_studio.jobs.task import UNUSABLE, Task, beside
from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.capture_import import CaptureImport
from avatarrex_studio.panels.files import FileDialog
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.files.gate import what_is

LABEL = 72.0
SIZES = {
    "smoke": "a few small pictures, in a minute",
    "small": "22 cameras, 80 frames, 384 × 512 pixels: what the packaged avatar was trained on",
    "paper": "22 cameras, 300 to 400 frames, 1500 × 2048 pixels: many hours",
}
SUBJECTS = {
    "default": "the printed shirt on the template's body",
    "other": "another body, that the template does not know",
}
GARMENTS = {"printed": "a printed shirt", "loose": "a loose tunic"}
RIGS = ("body", "face")


class Anew(NamedTuple):
    """A capture that is written anew from the one that is filled in."""

    act: str
    title: str
    what: str
    suffix: str
    """Of its folder's name."""
    sheets: str = ""
    """Of the pictures that it draws, by rig."""


ANEW = {
    "refine": Anew(
        "refine",
        "Refine",
        "Poses and size fitted anew to the capture's own mattes and keypoints; the pictures stay where they are.",
        "_refined",
        "refine_{}.png",
    ),
    "match": Anew(
        "match-exposure",
        "Match exposure",
        "One exposure and white balance for all cameras of a rig, by the colours of the person; pictures are linked, or copied from a zip.",
        "_matched",
    ),
}


class CaptureTools:
    """What is filled in."""

    def __init__(self, files: FileDialog) -> None:
        """`files`: the panel's dialog, which it draws."""
        self.shown = ""
        """`make`, `import`, one of `ANEW`, or nothing."""
        self.size, self.subject, self.garment, self.seed, self.noise = "small", "default", "printed", 0, 0.0
        self.out = ""
        self.imported = CaptureImport(files)

    def draw(self, capture: str) -> Task | None:
        """Draw them for the capture that is filled in; the task whose button was pressed."""
        path = capture.strip()
        buttons = {
            "make": f"{icons.ICON_FA_WAND_MAGIC_SPARKLES}  Make…",
            "import": f"{icons.ICON_FA_FILE_IMPORT}  Import…",
        }
        if path:
            buttons = {
                "check": f"{icons.ICON_FA_CLIPBOARD_CHECK}  Check",
                "refine": f"{icons.ICON_FA_CROSSHAIRS}  Refine…",
                "match": f"{icons.ICON_FA_CIRCLE_HALF_STROKE}  Exposure…",
                **buttons,
            }
        pressed = widgets.button_grid(buttons, 96, "capture.")
        if pressed == "check":
            return checking(path)
        if pressed:
            self.shown, self.out = ("" if self.shown == pressed else pressed), ""
        if self.shown == "make":
            return self._make()
        if self.shown == "import":
            return self.imported.draw()
        return self._anew(path, ANEW[self.shown]) if self.shown in ANEW and path else None

    def _make(self) -> Task | None:
        """A synthetic capture."""
        for title, name, choices in (
            ("Size", "size", SIZES),
            ("Subject", "subject", SUBJECTS),
            ("Garment", "garment", GARMENTS),
        ):
            widgets.label(title, LABEL)
            current = getattr(self, name)
            setattr(self, name, widgets.choice(f"##make.{name}", choices, current, current, choices) or current)
        widgets.label("", LABEL)
        widgets.paragraph(SIZES[self.size][0].upper() + SIZES[self.size][1:])
        widgets.label("Noise", LABEL)
        _, self.noise = imgui.slider_float("##make.noise", self.noise, 0.0, 2.0, "tracking × %.1f")
        widgets.label("Seed", LABEL)
        _, self.seed = imgui.input_int("##make.seed", self.seed)
        self.seed = max(self.seed, 0)
        out = self._into(f"capture_{self.size}")
        if not self._pressed("Make the capture", out):
            return None
        words = ("capture", "make", out, "--size", self.size, "--subject", self.subject, "--garment", self.garment,
                 "--seed", str(self.seed), "--tracking-noise", f"{self.noise:g}")  # fmt: skip
        return Task(f"Make {Path(out).name}", words, Path(beside(out, ".log")), capture=out)

    def _anew(self, capture: str, kind: Anew) -> Task | None:
        """The same pictures with better tracking, or in one exposure."""
        widgets.paragraph(kind.what)
        name = Path(capture).name.removesuffix(".zip")
        out = self._into(beside(str(Path(capture)).removesuffix(".zip"), kind.suffix))
        if not self._pressed(kind.title, out):
            return None
        pictures = tuple(Path(out) / kind.sheets.format(rig) for rig in RIGS if kind.sheets)
        return Task(
            f"{kind.title} {name}", ("capture", kind.act, capture, out), Path(beside(out, ".log")), pictures, out
        )

    def _into(self, hint: str) -> str:
        widgets.label("Into", LABEL)
        _, self.out = imgui.input_text_with_hint("##capture.out", hint, self.out)
        return os.path.expanduser(self.out.strip()) or hint

    def _pressed(self, title: str, out: str) -> bool:
        free = beside(out, ".log") and what_is(out) in ("nothing there", "a folder")
        imgui.begin_disabled(not free)
        pressed = imgui.button(f"{title}##capture.do", (widgets.room(), 0))
        imgui.end_disabled()
        if pressed:
            self.shown = ""
        return pressed


def checking(capture: str) -> Task:
    """The task that checks a capture; sheets lie in the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "avatarrex-studio" / "checks"
    folder = cache / hashlib.sha256(os.path.abspath(capture).encode()).hexdigest()[:16]
    words = ("capture", "check", capture, "--out", str(folder))
    pictures = tuple(folder / f"{rig}.png" for rig in RIGS)
    return Task(f"Check {Path(capture).name}", words, folder / "check.log", pictures, bad=(UNUSABLE,))
