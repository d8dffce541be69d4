"""The file dialog, drawn in the window: files and folders are picked, and no helper program of the desktop is needed."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.jobs.export_order import EXPORTED
from avatarrex_studio.jobs.file_kind import AVATAR, MOTION, kind_of
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.folder import Entry, listed, places
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.signals.read import READERS

SIZE = imgui.ImVec2(820, 500)
PLACES_WIDTH, BUTTON = 130.0, 110.0


@dataclass(frozen=True)
class Choice:
    """What a dialog is for."""

    what: str
    suffixes: tuple[str, ...]
    """Of files that are shown at first; the first is added to a name to write that has none."""
    folders: bool = False
    """Whether a folder can be picked, too."""


CHOICES: dict[str, Choice] = {
    **{kind: Choice(kind, endings) for kind, endings in EXPORTED.items()},
    "any": Choice("All that can be opened", (".avatar", *READERS, ".zip"), True),
    "motion": Choice("Motions", tuple(READERS)),
    "hand model": Choice("Hand models", (".npz", ".pkl")),
    "table": Choice("Tables", (".csv",)),
    "session": Choice("Sessions", (".json",)),
    "picture": Choice("Pictures", (".png", ".jpg", ".jpeg")),
    "capture": Choice("Captures", (".zip",), True),
}
KINDS = {".avatar": AVATAR, **{suffix: MOTION for suffix in READERS if suffix != ".json"}}
"""Of files, by extension; a `.json` may be a motion or a session."""


def is_kind(folder: str) -> bool:
    """Whether a folder as a whole is something that can be opened."""
    try:
        return bool(kind_of(folder))
    except InputError:
        return False


class FileDialog:
    """At most one dialog at a time, and what is done with its answer."""

    def __init__(self) -> None:
        self.folder = os.getcwd()
        """The one that is shown; kept from one time to the next."""
        self.name = ""
        """What is picked or typed: a name in the folder, or a path."""
        self.all_files = False
        self.is_open = False
        self._choice, self._title, self._save = CHOICES["any"], "", False
        self._then: Callable[[str], None] = lambda path: None
        self._entries: tuple[Entry, ...] = ()
        self._kinds: dict[str, str] = {}
        self._error = ""
        self._opening = False
        self._whole = False
        """Whether the folder as a whole can be picked."""

    def open(self, kind: str, title: str, then: Callable[[str], None]) -> None:
        """Choose something that exists, of a kind of `CHOICES`; `then` gets its path."""
        self._begin(kind, title, then, False)

    def save(self, kind: str, title: str, then: Callable[[str], None], folder: Path | None = None) -> None:
        """Choose a name to write, first in `folder`, else where the dialog was; `then` gets its path, with the kind's first
        suffix where it has none."""
        self.folder = self.folder if folder is None else str(folder)
        self._begin(kind, title, then, True)

    def _begin(self, kind: str, title: str, then: Callable[[str], None], save: bool) -> None:
        self._choice, self._title, self._then, self._save = CHOICES[kind], title, then, save
        self.name, self.all_files, self._opening, self.is_open = "", False, True, True
        self.go(self.folder)

    def go(self, folder: str) -> None:
        """Show a folder; one that cannot be read is said and changes nothing."""
        suffixes = () if self.all_files else self._choice.suffixes
        try:
            self._entries, self.folder, self._error = listed(folder, suffixes), os.path.abspath(folder), ""
        except InputError as error:
            self._error = str(error)
        self._kinds = {}
        self._whole = self._choice.folders and not self._save and is_kind(self.folder)

    def draw(self) -> None:
        """Draw the dialog where it is open, and pass on its answer."""
        if self._opening:
            imgui.open_popup("###files")
            self._opening = False
        screen = imgui.get_main_viewport()
        imgui.set_next_window_pos(screen.get_center(), imgui.Cond_.appearing, imgui.ImVec2(0.5, 0.5))
        size = imgui.ImVec2(min(SIZE.x, screen.size.x - 40), min(SIZE.y, screen.size.y - 40))
        imgui.set_next_window_size(size, imgui.Cond_.appearing)
        self.is_open, _ = imgui.begin_popup_modal(f"{self._title}###files", True)
        if not self.is_open:
            return
        self._path_row()
        height = -2 * imgui.get_frame_height_with_spacing() - 4
        with imgui_ctx.begin_child("##places", imgui.ImVec2(PLACES_WIDTH, height)):
            for name, path in places().items():
                if imgui.selectable(f"{name}##{path}", path == self.folder)[0]:
                    self.go(path)
        imgui.same_line()
        answer = self._table(height)
        answer = self._name_row() or answer
        if answer and not self._save and what_is(answer) == "a folder" and not is_kind(answer):
            self.go(answer)  # nothing that is opened as a whole
            self.name, answer = "", None
        if self._error:
            widgets.caption(self._error, theme.ERROR)
        if answer:
            imgui.close_current_popup()
        if imgui.is_key_pressed(imgui.Key.escape):
            imgui.close_current_popup()
        imgui.end_popup()
        if answer:
            self._then(answer)

    def _path_row(self) -> None:
        """One folder up, the path, read again."""
        if imgui.button(f"{icons.ICON_FA_ARROW_UP}##up", (32, 0)):
            self.go(os.path.dirname(self.folder))
        widgets.tooltip("One folder up")
        imgui.same_line()
        widgets.fill(40)
        entered, path = imgui.input_text("##folder", self.folder, imgui.InputTextFlags_.enter_returns_true)
        if entered:
            self.go(os.path.expanduser(path))
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_ROTATE_RIGHT}##again", (32, 0)):
            self.go(self.folder)
        widgets.tooltip("Read the folder again")

    def _table(self, height: float) -> str | None:
        """The entries; the path of a file that was double-clicked."""
        answer = None
        flags = imgui.TableFlags_.scroll_y | imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit
        if not imgui.begin_table("##entries", 4, flags, imgui.ImVec2(0, height)):
            return None
        imgui.table_setup_scroll_freeze(0, 1)
        imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch)
        kind = max([70.0, *(imgui.calc_text_size(each).x for each in set(self._kinds.values()))])
        for title, width in (("Kind", kind), ("Size", 70), ("Changed", 130)):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_fixed, width)
        imgui.table_headers_row()
        clipper = imgui.ListClipper()
        clipper.begin(len(self._entries))
        while clipper.step():
            for entry in self._entries[clipper.display_start : clipper.display_end]:
                answer = self._row(entry) or answer
        imgui.end_table()
        return answer

    def _row(self, entry: Entry) -> str | None:
        """One entry: a click picks it, a double click enters a folder or takes a file."""
        imgui.table_next_row()
        imgui.table_next_column()
        icon = icons.ICON_FA_FOLDER if entry.is_folder else icons.ICON_FA_FILE
        flags = imgui.SelectableFlags_.span_all_columns | imgui.SelectableFlags_.allow_double_click
        pressed, _ = imgui.selectable(f"{icon}  {entry.name}###{entry.name}", entry.name == self.name, flags)
        imgui.table_next_column()
        widgets.caption(self._kind(entry))
        imgui.table_next_column()
        widgets.caption(entry.size_words)
        imgui.table_next_column()
        widgets.caption(entry.changed_words)
        if not pressed:
            return None
        twice = imgui.is_mouse_double_clicked(imgui.MouseButton_.left)
        self._error = ""
        if entry.is_folder and (twice or not self._choice.folders):
            self.name = self.name if self._save else ""
            self.go(entry.path)
            return None
        self.name = entry.name
        return entry.path if twice and not self._save else None

    def _kind(self, entry: Entry) -> str:
        """What an entry is, as far as its name says; of a folder found out once it is on the screen."""
        if not entry.is_folder:
            return KINDS.get(os.path.splitext(entry.name)[1].lower(), "")
        if not self._choice.folders:
            return ""
        if entry.path not in self._kinds:
            try:
                self._kinds[entry.path] = kind_of(entry.path)
            except InputError:
                self._kinds[entry.path] = ""
        return self._kinds[entry.path]

    def _name_row(self) -> str | None:
        """What is picked, which files are shown, and the buttons; the answer where it was given."""
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        widgets.fill(270 + 2 * BUTTON)
        hint = "Name" if self._save or not self._choice.folders else "Name of a file or folder"
        entered, self.name = imgui.input_text_with_hint(
            "##name", hint, self.name, imgui.InputTextFlags_.enter_returns_true
        )
        imgui.same_line()
        imgui.set_next_item_width(240)
        shown = "All files" if self.all_files else self._choice.what
        chosen = widgets.choice("##shown", (self._choice.what, "All files"), shown, shown)
        if chosen and chosen != shown:
            self.all_files = not self.all_files
            self.go(self.folder)
        path = self._path()
        imgui.same_line()
        imgui.begin_disabled(path is None)
        pressed = imgui.button(f"{'Save' if self._save else 'Open'}###answer", (BUTTON, 0))
        imgui.end_disabled()
        imgui.same_line()
        if imgui.button("Cancel", (BUTTON, 0)):
            imgui.close_current_popup()
        return path if pressed or entered else None

    def _path(self) -> str | None:
        """What the name says, whole; None where nothing is picked."""
        name = os.path.expanduser(self.name.strip())
        if not name:
            return self.folder if self._whole else None
        if self._save and not os.path.splitext(name)[1]:
            name += self._choice.suffixes[0]
        return os.path.join(self.folder, name)
