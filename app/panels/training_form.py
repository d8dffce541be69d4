"""What a new training needs: a capture, a preset, the parts and a folder."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

from avatarrex_studio.jobs.training_process import PARTS, PRESETS
from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.files import FileDialogs
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui


class Order(NamedTuple):
    """A training that was asked for."""

    capture: str
    preset: str
    out: Path
    parts: list[str]


class TrainingForm:
    """The form as it stands."""

    def __init__(self) -> None:
        self.capture, self.preset, self.out, self.parts = "", PRESETS[0], "", list(PARTS)
        self.files = FileDialogs()

    def draw(self, folder: Path) -> Order | None:
        """Draw it; what to train comes back where the button was pressed. Runs lie in `folder` unless told."""
        order = None
        label = 72.0
        widgets.label("Capture", False, label)
        imgui.set_next_item_width(imgui.get_content_region_avail().x - 36)
        _, self.capture = imgui.input_text_with_hint("##capture", "Folder or .zip", self.capture)
        imgui.same_line(0, 4)
        if imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}##capture", imgui.ImVec2(32, 0)):
            self.files.open("capture", "Open a capture: its zip, or a file in its folder", self._took_capture)
        widgets.label("Preset", False, label)
        imgui.set_next_item_width(imgui.get_content_region_avail().x)
        if imgui.begin_combo("##preset", self.preset.capitalize()):
            for name in PRESETS:
                if imgui.selectable(name.capitalize(), name == self.preset)[0]:
                    self.preset = name
            imgui.end_combo()
        widgets.label("Parts", False, label)
        for number, name in enumerate(PARTS):
            if number:
                imgui.same_line(0, 14)
            toggled, on = imgui.checkbox(f"{name.capitalize()}##part", name in self.parts)
            if toggled:
                self.parts = [entry for entry in PARTS if (on if entry == name else entry in self.parts)]
        widgets.label("Into", False, label)
        imgui.set_next_item_width(imgui.get_content_region_avail().x)
        hint = str(folder / time.strftime("%Y-%m-%d"))
        _, self.out = imgui.input_text_with_hint("##out", hint, self.out)
        imgui.begin_disabled(not self.capture.strip() or not self.parts)
        if imgui.button(f"{icons.ICON_FA_PLAY}  Start training", imgui.ImVec2(imgui.get_content_region_avail().x, 0)):
            order = Order(self.capture, self.preset, Path(self.out.strip() or _free(Path(hint))), self.parts)
        imgui.end_disabled()
        imgui.spacing()
        return order

    def _took_capture(self, path: str) -> None:
        self.capture = path if path.endswith(".zip") or Path(path).is_dir() else str(Path(path).parent)


def _free(path: Path) -> Path:
    """`path`, or with a number behind it where it is taken."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate
