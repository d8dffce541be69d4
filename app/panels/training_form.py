"""What a new training needs: a capture, a recipe, the parts and a folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from avatarrex_studio.jobs.training_process import Order
from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.files import FileDialog
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.files.gate import what_is
from avatarrex.training.recipe import RECIPES, TRAINED

LABEL = 72.0
REFINED = "refine"
"""The recipe that goes on from an avatar."""


class TrainingForm:
    """The form as it is filled in."""

    def __init__(self) -> None:
        self.capture, self.recipe, self.out, self.parts = "", "quick", "", list(TRAINED)
        self.start, self.force = "", False
        """The avatar that `refine` goes on from; whether an unusable capture is trained on."""
        self.files = FileDialog()
        self._told = ("", "")
        """A capture, and what there is to say about it."""

    def draw(self, folder: Path, tools: Callable[[], None] = lambda: None) -> Order | None:
        """Draw it; the training to start where the button was pressed. Runs lie in `folder` unless told. `tools` draws what can be done
        with the capture.
        """
        widgets.label("Capture", LABEL)
        widgets.fill(36)
        _, self.capture = imgui.input_text_with_hint("##capture", "Folder or .zip", self.capture)
        imgui.same_line(0, 4)
        if imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}##capture", (32, 0)):
            self.files.open("capture", "Open a capture", self.take)
        told, words = self._told
        if words and told == self.capture:
            widgets.label("", LABEL)
            widgets.paragraph(words)
        tools()
        widgets.label("Recipe", LABEL)
        shown, titles = self.recipe.capitalize(), {name.capitalize(): recipe.about for name, recipe in RECIPES.items()}
        about = RECIPES[self.recipe].about
        self.recipe = (widgets.choice("##recipe", titles, shown, shown, titles) or shown).lower()
        widgets.label("", LABEL)
        widgets.paragraph(about[0].upper() + about[1:])
        if self.recipe == REFINED:
            widgets.label("From", LABEL)
            _, self.start = imgui.input_text_with_hint("##start", "An avatar of quick or long", self.start)
        widgets.label("Parts", LABEL)
        for name in widgets.in_rows(TRAINED, 14):
            toggled, on = imgui.checkbox(f"{name.capitalize()}##part", name in self.parts)
            if toggled:
                self.parts = [entry for entry in TRAINED if (on if entry == name else entry in self.parts)]
        widgets.label("Into", LABEL)
        hint = str(folder / time.strftime("%Y-%m-%d"))
        _, self.out = imgui.input_text_with_hint("##out", hint, self.out)
        _, self.force = imgui.checkbox("Train even if the check finds it unusable##force", self.force)
        incomplete = not self.capture.strip() or not self.parts or (self.recipe == REFINED and not self.start.strip())
        imgui.begin_disabled(incomplete)
        started = imgui.button(f"{icons.ICON_FA_PLAY}  Start training", (widgets.room(), 0))
        imgui.end_disabled()
        imgui.spacing()
        if not started:
            return None
        out, start = Path(self.out.strip() or _free(Path(hint))), self.start.strip() if self.recipe == REFINED else ""
        return Order(self.capture, self.recipe, out, self.parts, start, self.force)

    def take(self, capture: str, words: str = "") -> None:
        """Fill in a capture, with what there is to say about it."""
        self.capture, self._told = capture, (capture, words)


def _free(path: Path) -> Path:
    """`path`, or with a number after it where it is taken."""
    number, candidate = 1, path
    while what_is(candidate) in ("a file", "a folder"):
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate
