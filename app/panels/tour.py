"""*Help → Tour*: five steps that show where things are, a sentence each; and the hint that a first start has in the menu bar.

Neither takes the mouse away from what it shows: whoever reads can try it at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from avatarrex_studio.panels import mouse, theme, widgets
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

Corners = tuple[imgui.ImVec2, imgui.ImVec2]


@dataclass(frozen=True)
class Step:
    """A place and what one does there."""

    panel: str
    title: str
    text: str


PICTURE = "Viewport"
STEPS = (
    Step(PICTURE, "Look around", "In the picture:\n{drags}\nThe wheel zooms, Home shows the whole person."),
    Step(PICTURE, "Grab a hand",
         "Move the mouse to a wrist and drag the round handle: the arm follows. A click on a part shows rings that turn it."),
    Step("Poses", "Take a pose", "Click a card. Blend says how much of it; Ctrl+Z brings back what was before."),
    Step("Face", "Make it smile", "Drag Smile. Below are the brows, the eyes, the lips, and every muscle by region."),
    Step("Timeline", "Play a motion, keep a picture",
         "Choose one of Motions and press Space. F12 saves a picture, Ctrl+E a video or a model."),
)  # fmt: skip
HINT = "{orbit} looks around. Move the mouse to a hand and drag its handle."
WIDTH, GAP = 330.0, 14.0
_FLAGS = (
    imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_nav | imgui.WindowFlags_.no_move | imgui.WindowFlags_.always_auto_resize
)  # fmt: skip


class Tour:
    """Not under way at first."""

    def __init__(self) -> None:
        self.number: int | None = None
        """The step that is shown."""
        self.preset = "default"
        """Of the mouse: what the texts say."""
        self.reveal = ""
        """The panel to be brought to the front."""

    def start(self) -> None:
        """The first step."""
        self._go(0)

    def stop(self) -> None:
        """No more."""
        self.number = None

    def draw(self) -> None:
        """Draw the step: a frame around its panel, and a card in the lower corner of the picture."""
        if self.number is None:
            return
        step = STEPS[self.number]
        low, high = _corners(step.panel)
        imgui.get_foreground_draw_list().add_rect(low, high, theme.colour(theme.ACCENT), 6.0, thickness=2.5)
        picture = _corners(PICTURE)  # the card stays where it is, so that the next press is where the last one was
        imgui.set_next_window_pos((picture[0].x + GAP, picture[1].y - GAP), imgui.Cond_.always, (0.0, 1.0))
        imgui.set_next_window_size_constraints((WIDTH, 0), (WIDTH, 400))
        with _raised("##tour"):
            widgets.caption(f"{self.number + 1} of {len(STEPS)}")
            widgets.paragraph(step.title, theme.ACCENT)
            widgets.paragraph(self.said(step.text), theme.TEXT)
            imgui.spacing()
            last = self.number + 1 == len(STEPS)
            if imgui.button(f"{'Done' if last else 'Next'}###tour.next", (92, 0)):
                self._go(self.number + 1)
            imgui.same_line()
            imgui.begin_disabled(self.number == 0)
            if imgui.button("Back###tour.back", (72, 0)):
                self._go((self.number or 0) - 1)
            imgui.end_disabled()
            imgui.same_line()
            if not last and imgui.button("Skip###tour.skip", (72, 0)):
                self.stop()

    def said(self, text: str) -> str:
        """A text with what the mouse does."""
        drags = mouse.drags(self.preset)
        return text.format(drags="\n".join(f"{what}: {ways.lower()}" for ways, what in drags), orbit=drags[0][0])

    def _go(self, number: int) -> None:
        self.number = number if 0 <= number < len(STEPS) else None
        self.reveal = STEPS[number].panel if self.number is not None else ""


def draw_hint(tour: Tour) -> bool:
    """The hint at the right of the menu bar, where it covers nothing; whether it is still wanted. Without room for it the buttons alone."""
    text, tip, close = tour.said(HINT), "Show me five things", icons.ICON_FA_XMARK
    style = imgui.get_style()
    widths = [imgui.calc_text_size(each).x for each in (text, tip, close)]
    buttons = sum(widths[1:]) + 4 * style.frame_padding.x + 2 * style.item_spacing.x
    spare = widgets.room() - buttons - 2 * style.item_spacing.x
    if spare < 0:
        return True
    whole = spare > widths[0] + 20
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + spare - (widths[0] + style.item_spacing.x if whole else 0))
    if whole:
        widgets.caption(text, theme.ACCENT)
    begun = imgui.small_button(f"{tip}###hint.tour")
    widgets.tooltip(text)
    if begun:
        tour.start()
    closed = imgui.small_button(f"{close}###hint.close")
    widgets.tooltip("Not now")
    return not (begun or closed)


@contextmanager
def _raised(name: str) -> Iterator[None]:
    """A window without a frame of its own, over the others but under dialogs."""
    with (
        imgui_ctx.push_style_var(imgui.StyleVar_.window_border_size, 1.0),
        imgui_ctx.push_style_color(imgui.Col_.border, theme.vec4(theme.ACCENT, 0.6)),
        imgui_ctx.push_style_color(imgui.Col_.window_bg, theme.vec4(theme.PANEL, 0.97)),
        imgui_ctx.begin(name, None, _FLAGS),
    ):
        if imgui.internal.get_top_most_popup_modal() is None:
            imgui.internal.bring_window_to_display_front(imgui.internal.get_current_window())
        yield


def _corners(panel: str) -> Corners:
    """Of a panel on the screen; of the whole window where it is not there."""
    window, screen = imgui.internal.find_window_by_name(panel), imgui.get_main_viewport()
    if window is None or not window.was_active:
        return screen.work_pos, screen.work_pos + screen.work_size
    return window.pos, window.pos + window.size
