"""File dialogs inside the window: no helper program of the desktop is needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from imgui_bundle import im_file_dialog, imgui

FILTERS = {
    "motion": "Motion (*.bvh;*.amc;*.fbx;*.npz;*.npy;*.csv;*.json){.bvh,.amc,.fbx,.npz,.npy,.csv,.json},.*",
    "session": "Session (*.json){.json},.*",
    "capture": "Capture (*.zip;*.json;*.npz){.zip,.json,.npz},.*",
}
NAME_FIELD = "##file_input"
"""Id of the dialog's field for the name."""


class FileDialogs:
    """At most one dialog at a time, and what is done with its answer."""

    def __init__(self) -> None:
        self._waiting: dict[str, Callable[[str], None]] = {}
        self._name_in = ""
        """Title of the dialog whose field for the name is to get the cursor."""

    def open(self, kind: str, title: str, then: Callable[[str], None]) -> None:
        """Choose an existing file; `then` gets its path."""
        im_file_dialog.FileDialog.instance().open(kind, title, FILTERS[kind])
        self._waiting[kind] = then

    def save(self, kind: str, title: str, then: Callable[[str], None], folder: Path) -> None:
        """Choose a name to write, first in `folder`; `then` gets its path, with the first ending of its kind where it has none."""
        im_file_dialog.FileDialog.instance().save(kind, title, FILTERS[kind], str(folder))
        ending = FILTERS[kind].partition("{")[2].partition(",")[0].rstrip("}")
        self._waiting[kind] = lambda path: then(path if Path(path).suffix else path + ending)
        self._name_in = f"{title}###{kind}"

    def draw(self) -> None:
        """Draw the open dialog and pass on its answer."""
        dialog = im_file_dialog.FileDialog.instance()
        for kind, then in list(self._waiting.items()):
            done = dialog.is_done(kind)
            if self._name_in:
                self._focus_name()
            if done:
                answer = dialog.get_result().path() if dialog.has_result() else None
                dialog.close()
                del self._waiting[kind]
                if answer:
                    then(answer)

    def _focus_name(self) -> None:
        """Put the cursor into the field for the name, once the dialog is there."""
        window = imgui.internal.find_window_by_name(self._name_in)
        if window is not None and window.active:
            imgui.internal.activate_item_by_id(window.get_id(NAME_FIELD))
            imgui.get_current_context().nav_next_activate_flags = imgui.internal.ActivateFlags_.prefer_input
            self._name_in = ""
