"""The list of runs: which are drawn, which one is chosen, and how far each has come."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from avatarrex_studio.jobs.run_view import RunView, duration
from avatarrex_studio.panels import theme
from avatarrex_studio.panels.curves import COLOURS
from imgui_bundle import imgui

STATE_COLOURS = {
    "running": (0.47, 0.79, 0.50), "paused": theme.WARNING, "finished": theme.ACCENT, "stopped": theme.MUTED,
    "failed": theme.ERROR, "dead": theme.ERROR,
}  # fmt: skip


class RunList:
    """Tick boxes, colours and the choice outlast what is read of the runs."""

    def __init__(self) -> None:
        self.chosen: Path | None = None
        """The run whose details, buttons and terms are shown."""
        self.colours: dict[Path, tuple[float, float, float]] = {}
        self._hidden: set[Path] = set()

    def follow(self, views: Sequence[RunView]) -> RunView | None:
        """Take note of new runs; the chosen one, else the live or newest."""
        for view in views:
            self.colours.setdefault(view.path, COLOURS[len(self.colours) % len(COLOURS)])
        chosen = next((view for view in views if view.path == self.chosen), None)
        if chosen is None and views:
            return max(views, key=lambda view: (view.live, view.about.get("started") or 0))
        return chosen

    def ticked(self, views: Sequence[RunView]) -> list[RunView]:
        """Those whose curves are drawn."""
        return [view for view in views if view.path not in self._hidden]

    def draw(self, views: Sequence[RunView]) -> None:
        """Draw an entry for each."""
        for view in views:
            self._entry(view)

    def _entry(self, view: RunView) -> None:
        """One run of the list: tick box, name, state, progress."""
        imgui.push_id(str(view.path))
        colour, state = self.colours[view.path], STATE_COLOURS.get(view.state, theme.MUTED)
        imgui.push_style_color(imgui.Col_.check_mark, theme.vec4(colour))
        toggled, _ = imgui.checkbox("##shown", view.path not in self._hidden)
        imgui.pop_style_color()
        if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
            imgui.set_tooltip("Draw its curves")
        if toggled:
            self._hidden ^= {view.path}
        imgui.same_line()
        start, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
        line = imgui.get_text_line_height()
        size = imgui.ImVec2(width, 2 * line + 16)
        if imgui.selectable("##choose", view.path == self.chosen, 0, size)[0]:
            self.chosen = view.path
        canvas, pad = imgui.get_window_draw_list(), 6.0

        def write(x: float, y: float, text: str, rgb: tuple[float, float, float]) -> None:
            canvas.add_text(imgui.ImVec2(start.x + x, start.y + y), theme.colour(rgb), text)

        end = imgui.calc_text_size(view.state).x
        dot = imgui.ImVec2(start.x + width - end - pad - 9, start.y + 2 + line / 2)
        canvas.push_clip_rect(start, imgui.ImVec2(dot.x - 8, start.y + size.y), True)
        write(pad, 2, view.name, theme.TEXT if view.path not in self._hidden else theme.MUTED)
        canvas.pop_clip_rect()
        canvas.add_circle_filled(dot, 3, theme.colour(state))
        write(width - end - pad, 2, view.state, state)
        canvas.push_clip_rect(start, imgui.ImVec2(start.x + width, start.y + size.y), True)
        write(pad, line + 5, _progress(view), theme.MUTED)
        canvas.pop_clip_rect()
        low = imgui.ImVec2(start.x + pad, start.y + size.y - 6)
        high = imgui.ImVec2(start.x + width - pad, low.y + 3)
        canvas.add_rect_filled(low, high, theme.colour(theme.TEXT, 0.08), 1.5)
        if view.progress:
            high = imgui.ImVec2(low.x + view.progress * (high.x - low.x), high.y)
            canvas.add_rect_filled(low, high, theme.colour(colour, 0.9), 1.5)
        imgui.pop_id()


def _progress(view: RunView) -> str:
    """`Body I   1,240 / 4,000   24.3 dB   12 min left`."""
    psnr = view.last("heldout/psnr")
    words = [
        f"{view.part.capitalize()} {view.pass_name}".strip(),
        f"{view.step:,} / {view.steps:,}" if view.steps else f"step {view.step:,}",
        f"{psnr:.1f} dB" if psnr is not None else "",
        f"{duration(view.eta)} left" if view.eta is not None else "",
    ]
    return "   ".join(filter(None, words))
