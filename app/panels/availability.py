"""*Help → What is available*: what this machine has, and the next step for what is missing."""

from __future__ import annotations

from collections.abc import Callable

from avatarrex_studio.jobs.available import Ability, available, lines
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

TITLE = "What is available"
WIDTH, NAME = 640.0, 140.0


class Availability:
    """The page; closed at first, and looked anew each time it opens."""

    def __init__(self, look: Callable[[], tuple[Ability, ...]] = available) -> None:
        self.found: tuple[Ability, ...] = ()
        self._look = look
        self._opening = False

    def open(self) -> None:
        """Show it at the next frame."""
        self._opening = True

    def draw(self) -> None:
        """Draw the page where it is open."""
        if self._opening:
            self._opening = False
            self.found = self._look()
            imgui.open_popup(TITLE)
        screen = imgui.get_main_viewport()
        imgui.set_next_window_pos(screen.get_center(), imgui.Cond_.always, (0.5, 0.5))
        imgui.set_next_window_size((min(WIDTH, screen.size.x - 20), min(500.0, screen.size.y - 20)))
        if not imgui.begin_popup_modal(
            TITLE, None, imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_saved_settings
        )[0]:
            return
        with imgui_ctx.begin_child("##abilities", imgui.ImVec2(0, -imgui.get_frame_height_with_spacing())):
            for entry in self.found:
                _row(entry)
        if imgui.button(f"{icons.ICON_FA_CHECK}  Close##available", (110, 0)):
            imgui.close_current_popup()
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_COPY}  Copy##available", (110, 0)):
            imgui.set_clipboard_text("\n".join(lines(self.found)))
        imgui.end_popup()


def _row(entry: Ability) -> None:
    icon, colour = (icons.ICON_FA_CHECK, theme.ACCENT) if entry.there else (icons.ICON_FA_MINUS, theme.MUTED)
    widgets.caption(icon, colour)
    imgui.same_line(28)
    widgets.caption(entry.name, theme.TEXT)
    imgui.same_line(28 + NAME)
    with imgui_ctx.begin_group():
        widgets.paragraph(entry.words)
        if entry.next_step:
            widgets.paragraph(entry.next_step, theme.TEXT)
    imgui.spacing()
