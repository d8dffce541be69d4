"""File dialogs inside the window: no helper program of the desktop is needed."""

from __future__ import annotations

from collections.abc import Callable

from imgui_bundle import im_file_dialog

FILTERS = {
    "motion": "Motion (*.bvh;*.amc;*.fbx;*.npz;*.npy;*.csv;*.json){.bvh,.amc,.fbx,.npz,.npy,.csv,.json},.*",
    "session": "Session (*.json){.json},.*",
    "capture": "Capture (*.zip;*.json;*.npz){.zip,.json,.npz},.*",
}


class FileDialogs:
    """At most one dialog at a time, and what is done with its answer."""

    def __init__(self) -> None:
        self._waiting: dict[str, Callable[[str], None]] = {}

    def open(self, kind: str, title: str, then: Callable[[str], None], save: bool = False) -> None:
        """Choose an existing file, or with `save` a name to write; `then` gets its path."""
        dialog = im_file_dialog.FileDialog.instance()
        (dialog.save if save else dialog.open)(kind, title, FILTERS[kind])
        self._waiting[kind] = then

    def draw(self) -> None:
        """Draw the open dialog and pass on its answer."""
        dialog = im_file_dialog.FileDialog.instance()
        for kind, then in list(self._waiting.items()):
            if dialog.is_done(kind):
                answer = dialog.get_result().path() if dialog.has_result() else None
                dialog.close()
                del self._waiting[kind]
                if answer:
                    then(answer)
