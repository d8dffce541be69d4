"""Save, rename and delete a user's own poses: a name to type, a menu on each card, a question before anything is lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.session.user_library import Entry, UserLibrary, taken
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals

QUESTION, MENU = "Library##question", "own entry"
LOOK = 2.0
"""Seconds between two looks for what others have changed in the folder."""


class OwnEntries:
    """The user's library with its widgets."""

    def __init__(self, library: UserLibrary | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.library, self._clock = library or UserLibrary(), clock
        self.name, self.new_name, self.error = "", "", ""
        self._looked = -LOOK
        """When the folder was looked at, seconds."""
        self._menu: Entry | None = None
        self._overwriting: Entry | None = None
        self._deleting: Entry | None = None
        self._opened: str | None = None
        """A popup to be opened in this frame."""

    def entries(self, kind: str) -> Mapping[str, Entry]:
        """By id: the user's names with a mark that no shipped entry has."""
        if self._clock() - self._looked >= LOOK:
            self._looked = self._clock()
            self.library.follow()
        return {f"own:{name}": entry for name, entry in self.library.entries[kind].items()}

    def open_menu(self, entry: Entry) -> None:
        """The menu of a card."""
        self._menu, self.new_name, self._opened = entry, entry.name, MENU

    def draw(self, signals: Signals, kind: str, side: str) -> None:
        """The line that saves what is shown, what went wrong, and what is open."""
        widgets.fill(78)
        _, self.name = imgui.input_text_with_hint("##own.name", f"Name of this {kind}", self.name)
        imgui.same_line()
        imgui.begin_disabled(not self.name.strip())
        if imgui.button(f"{icons.ICON_FA_FLOPPY_DISK}  Save##own", (70, 0)):
            self._save(taken(signals, kind, self.name.strip(), "right" if side == "right" else "left"))
        imgui.end_disabled()
        widgets.tooltip(f"Kept in {self.library.folder}")
        if self.error:
            widgets.paragraph(self.error, theme.ERROR)
        for line in self.library.refused[:3]:
            widgets.paragraph(line, theme.WARNING)
        if self._opened:
            imgui.open_popup(self._opened)
            self._opened = None
        self._draw_menu()
        self._draw_question()

    def _save(self, entry: Entry) -> None:
        if entry.name in self.library.entries[entry.kind]:
            self._overwriting, self._opened = entry, QUESTION
        elif self._do(lambda: self.library.save(entry)):
            self.name = ""

    def _draw_menu(self) -> None:
        if not imgui.begin_popup(MENU):
            return
        entry = self._menu
        assert entry is not None
        widgets.caption(entry.name, theme.TEXT)
        imgui.set_next_item_width(170)
        entered, self.new_name = imgui.input_text(
            "##own.rename", self.new_name, imgui.InputTextFlags_.enter_returns_true
        )
        imgui.same_line()
        if (imgui.button("Rename##own") or entered) and self._do(
            lambda: self.library.rename(entry.kind, entry.name, self.new_name.strip())
        ):
            imgui.close_current_popup()
        if imgui.selectable(f"{icons.ICON_FA_TRASH}  Delete…", False)[0]:
            self._deleting, self._opened = entry, QUESTION
        imgui.end_popup()

    def _draw_question(self) -> None:
        """Before an entry is overwritten or deleted."""
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, imgui.ImVec2(0.5, 0.5))
        if not imgui.begin_popup_modal(QUESTION, None, imgui.WindowFlags_.always_auto_resize)[0]:
            return
        entry = self._deleting or self._overwriting
        assert entry is not None
        verb = "Delete" if self._deleting else "Overwrite"
        imgui.text(f"{verb} “{entry.name}”? This cannot be undone.")
        imgui.spacing()
        if imgui.button(f"{verb}##own", (110, 0)):
            self._do(
                (lambda: self.library.delete(entry.kind, entry.name))
                if self._deleting
                else (lambda: self.library.save(entry, overwrite=True))
            )
            self.name = self.name if self._deleting else ""
            self._done()
        imgui.same_line()
        if imgui.button("Keep it##own", (110, 0)) or imgui.is_key_pressed(imgui.Key.escape):
            self._done()
        imgui.end_popup()

    def _done(self) -> None:
        self._deleting = self._overwriting = None
        imgui.close_current_popup()

    def _do(self, change: Callable[[], None]) -> bool:
        """A change of the folder; what the disk refuses is said in the panel."""
        try:
            change()
        except InputError as error:
            self.error = str(error)
            return False
        self.error = ""
        return True
