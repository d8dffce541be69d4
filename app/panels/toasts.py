"""Toasts: what the log has for the user, at the lower right of the viewport, for some seconds. A click opens the Console."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.session.notice import NOTICE
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

from avatarrex.errors import InputError

MOST = 4
"""At once; older ones go."""
SECONDS = {logging.ERROR: 12.0, logging.WARNING: 10.0, NOTICE: 7.0}
FADE = 0.6
"""Seconds."""
WIDTH, GAP = 360.0, 10.0
LOOKS = {
    logging.ERROR: (icons.ICON_FA_CIRCLE_EXCLAMATION, theme.ERROR),
    logging.WARNING: (icons.ICON_FA_TRIANGLE_EXCLAMATION, theme.WARNING),
    NOTICE: (icons.ICON_FA_CIRCLE_CHECK, theme.ACCENT),
}
MORE = "Click to open the Console"
_FLAGS = (
    imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_focus_on_appearing | imgui.WindowFlags_.no_nav | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.always_auto_resize
)  # fmt: skip


@dataclass
class Toast:
    """One message; `times` it came, the last at `since`, in seconds of the clock."""

    level: int
    title: str
    next_step: str
    since: float
    times: int = 1

    def alpha(self, now: float) -> float:
        """How opaque it is; 0 once it is over."""
        left = self.since + SECONDS[self.level] - now
        return min(max(left / FADE, 0.0), 1.0)


class Toasts(logging.Handler):
    """A log handler that draws itself; lines about a file that a user opens go to `refused` instead, with the file's name."""

    def __init__(
        self, refused: Callable[[str, str], None] | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(NOTICE)
        self.shown: list[Toast] = []
        self._refused, self._clock = refused, clock

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one record, of any thread; the same again is counted."""
        opening = getattr(record, "opening", "")
        title, next_step = said(record)
        if opening and self._refused:
            self._refused(opening, f"{title}\n{next_step}")
            return
        level = next(name for name in SECONDS if record.levelno >= name)
        same = next((toast for toast in self.shown if (toast.level, toast.title) == (level, title)), None)
        if same:
            same.times, same.since = same.times + 1, self._clock()
        else:
            self.shown = [*self.shown, Toast(level, title, next_step, self._clock())][-MOST:]

    @property
    def moving(self) -> bool:
        """Whether one fades."""
        now = self._clock()
        return any(toast.alpha(now) < 1 for toast in self.shown)

    def draw(self, low: tuple[float, float], high: tuple[float, float]) -> bool:
        """Draw them, the newest lowest, into a rectangle of the screen; whether one was clicked."""
        now = self._clock()
        self.shown = [toast for toast in self.shown if toast.alpha(now) > 0]
        bottom, clicked = high[1] - GAP, None
        for number, toast in reversed(list(enumerate(self.shown))):
            width = min(WIDTH, high[0] - low[0] - 2 * GAP)
            if width < 80 or bottom < low[1] + 40:
                break
            height, pressed = _draw(number, toast, toast.alpha(now), (high[0] - GAP - width, bottom), width)
            bottom -= height + GAP
            clicked = toast if pressed else clicked
        if clicked:
            self.shown = [toast for toast in self.shown if toast is not clicked]
        return clicked is not None


def said(record: logging.LogRecord) -> tuple[str, str]:
    """What happened and what to do next."""
    arguments = record.args if isinstance(record.args, tuple) else ()
    refusal = next((entry for entry in arguments if isinstance(entry, InputError)), None)
    if refusal:
        place = f"{refusal.source}: {refusal.field}" if refusal.field else refusal.source
        return f"{place}: found {refusal.found}", f"Needed: {refusal.expected}"
    cause = record.exc_info[1] if record.exc_info else None
    text = record.getMessage() + (f": {type(cause).__name__}: {cause}" if cause else "")
    return text, MORE if record.levelno >= logging.WARNING else ""


def _draw(number: int, toast: Toast, alpha: float, corner: tuple[float, float], width: float) -> tuple[float, bool]:
    """One, its lower left corner on the screen given; its height and whether it was clicked."""
    icon, colour = LOOKS[toast.level]
    imgui.set_next_window_pos(corner, imgui.Cond_.always, (0.0, 1.0))
    imgui.set_next_window_size_constraints((width, 0), (width, 400))
    with (
        imgui_ctx.push_style_var(imgui.StyleVar_.alpha, max(alpha, 0.02)),
        imgui_ctx.push_style_color(imgui.Col_.window_bg, theme.vec4(theme.RAISED, 0.97)),
        imgui_ctx.begin(f"##toast{number}", None, _FLAGS),
    ):
        if imgui.internal.get_top_most_popup_modal() is None:
            imgui.internal.bring_window_to_display_front(imgui.internal.get_current_window())
        widgets.caption(icon, colour)
        imgui.same_line(34)
        with imgui_ctx.begin_group():
            widgets.paragraph(toast.title + (f"  (× {toast.times})" if toast.times > 1 else ""), theme.TEXT)
            if toast.next_step:
                widgets.paragraph(toast.next_step)
        pressed = imgui.is_window_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.left)
        return imgui.get_window_height(), pressed
