"""The command palette (Ctrl+P) and the sheet of shortcuts (F1); both read the list of actions."""

from __future__ import annotations

from collections.abc import Iterable

from avatarrex_studio.panels import mouse, theme, widgets
from avatarrex_studio.session.actions import ACTIONS, Action, find
from avatarrex_studio.session.journal import Journal
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

ROWS = 12
COLUMN = 300.0
"""Points that a column of the sheet needs."""
MOUSE = (
    ("Click on the person", "Select a joint or a region of the face"), ("Drag a ring", "Turn the joint"),
    ("Drag a round handle", "Pull hand, foot, elbow, knee, head or pelvis"), ("Right click on the person", "Pin, reset, look here"),
    ("Wheel", "Zoom"),
    ("Double click in the picture", "Centre on that point"), ("Double click on a slider", "Reset it"),
    ("Ctrl+click on a slider", "Type a value"), ("Alt or Shift on a slider", "Finer or coarser"),
)  # fmt: skip


class Palette:
    """Both popups."""

    def __init__(self) -> None:
        self.text, self.chosen = "", 0
        self.preset = "default"
        """Of the mouse, for the sheet."""
        self._open_palette = self._open_sheet = False

    def open(self) -> None:
        """Show the palette at the next frame."""
        self.text, self.chosen, self._open_palette = "", 0, True

    def open_sheet(self) -> None:
        """Show the shortcuts at the next frame."""
        self._open_sheet = True

    def draw(self, journal: Journal) -> Action | None:
        """Draw what is open; the action that was chosen."""
        self._sheet()
        if self._open_palette:
            imgui.open_popup("palette")
            self._open_palette = False
        screen = imgui.get_main_viewport()
        width = min(520.0, screen.size.x - 40)
        imgui.set_next_window_pos((screen.pos.x + (screen.size.x - width) / 2, screen.pos.y + 0.16 * screen.size.y))
        imgui.set_next_window_size((width, 0))
        if not imgui.begin_popup("palette"):
            return None
        chosen = self._content(journal)
        if chosen:
            imgui.close_current_popup()
        imgui.end_popup()
        return chosen

    def _content(self, journal: Journal) -> Action | None:
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(-1)
        before = self.text
        entered, self.text = imgui.input_text_with_hint(
            "##palette", "Type a command", self.text, imgui.InputTextFlags_.enter_returns_true
        )
        found = [entry for entry in find(self.text) if entry.enabled(journal)]
        step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
        self.chosen = min(max(self.chosen + step, 0), len(found) - 1) if before == self.text else 0
        first = max(0, min(self.chosen - ROWS // 2, len(found) - ROWS))
        picked = None
        right = imgui.get_cursor_pos_x() + widgets.room()
        for number, entry in list(enumerate(found))[first : first + ROWS]:
            if imgui.selectable(f"{entry.title}##{entry.id}", number == self.chosen)[0]:
                picked = entry
            if entry.shortcut:
                imgui.same_line(right - imgui.calc_text_size(entry.shortcut).x)
                widgets.caption(entry.shortcut)
        if not found:
            widgets.caption("Nothing by that name")
        return found[self.chosen] if entered and found else picked

    def _sheet(self) -> None:
        if self._open_sheet:
            imgui.open_popup("Keyboard and mouse")
            self._open_sheet = False
        screen = imgui.get_main_viewport()
        imgui.set_next_window_pos(screen.get_center(), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
        imgui.set_next_window_size_constraints((0, 0), (screen.size.x - 20, screen.size.y - 20))
        shown, _ = imgui.begin_popup_modal("Keyboard and mouse", None, imgui.WindowFlags_.always_auto_resize)
        if not shown:
            return
        keys = [(entry.shortcut, entry.title.rstrip("…")) for entry in ACTIONS if entry.shortcut]
        third = -(-(len(keys) + len(MOUSE) + 3) // 3)
        for name, rows in widgets.in_rows(
            {
                "keys": keys[:third],
                "more": keys[third : 2 * third],
                "mouse": [*keys[2 * third :], *mouse.drags(self.preset), *MOUSE],
            }.items(),
            30,
            max(1, min(3, int(screen.size.x / COLUMN))),
        ):
            _table(name, rows)
        imgui.spacing()
        if imgui.button(f"{icons.ICON_FA_CHECK}  Close", (110, 0)):
            imgui.close_current_popup()
        imgui.end_popup()


def _table(name: str, rows: Iterable[tuple[str, str]]) -> None:
    cells = (((widgets.caption, key, theme.ACCENT), (widgets.caption, title, theme.TEXT)) for key, title in rows)
    widgets.table(name, imgui.TableFlags_.sizing_fixed_fit | imgui.TableFlags_.no_host_extend_x, cells)
