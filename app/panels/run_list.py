"""The list of runs: which are drawn, which one is chosen, and the progress of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from avatarrex_studio.jobs.run_view import RunView, duration
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import imgui, imgui_ctx

STATE_COLOURS = {
    "running": theme.RUNNING, "paused": theme.WARNING, "finished": theme.ACCENT, "stopped": theme.MUTED,
    "failed": theme.ERROR, "dead": theme.ERROR,
}  # fmt: skip

PAD = 6.0
"""Points around what an entry says."""


class RunList:
    """Tick boxes, colours and the choice outlast what is read of the runs."""

    def __init__(self) -> None:
        self.chosen: Path | None = None
        """The run that details, buttons and terms are shown of."""
        self.colours: dict[Path, theme.Rgb] = {}
        self._hidden: set[Path] = set()

    def follow(self, views: Sequence[RunView]) -> RunView | None:
        """Take note of new runs; the chosen one, else the live or newest."""
        for view in views:
            self.colours.setdefault(view.path, theme.CURVES[len(self.colours) % len(theme.CURVES)])
        chosen = next((view for view in views if view.path == self.chosen), None)
        if chosen is None and views:
            return max(views, key=lambda view: (view.live, view.about.get("started") or 0))
        return chosen

    def ticked(self, views: Sequence[RunView]) -> list[RunView]:
        """Those with their curves drawn."""
        return [view for view in views if view.path not in self._hidden]

    def draw(self, views: Sequence[RunView]) -> None:
        """Draw an entry for each: tick box, name, state, progress."""
        for view in views:
            with imgui_ctx.push_id(str(view.path)):
                colour, ticked = self.colours[view.path], view.path not in self._hidden
                with imgui_ctx.push_style_color(imgui.Col_.check_mark, theme.vec4(colour)):
                    toggled, _ = imgui.checkbox("##shown", ticked)
                widgets.tooltip("Draw its curves")
                if toggled:
                    self._hidden ^= {view.path}
                imgui.same_line()
                start, size = imgui.get_cursor_screen_pos(), (widgets.room(), 2 * imgui.get_text_line_height() + 16)
                if imgui.selectable("##choose", view.path == self.chosen, 0, size)[0]:
                    self.chosen = view.path
                _write(view, start, size, colour, theme.TEXT if ticked else theme.MUTED)


def _write(view: RunView, start: imgui.ImVec2, size: tuple[float, float], colour: theme.Rgb, tint: theme.Rgb) -> None:
    """Name (in `tint`), state, progress in words and as a bar (in `colour`), over the entry at `start`."""
    canvas, line = imgui.get_window_draw_list(), imgui.get_text_line_height()
    state = theme.colour(STATE_COLOURS.get(view.state, theme.MUTED))
    left, right, bottom = start.x + PAD, start.x + size[0] - PAD, start.y + size[1]
    word = right - imgui.calc_text_size(view.state).x
    dot = (word - 9, start.y + 2 + line / 2)
    canvas.push_clip_rect(start, (dot[0] - 8, bottom), True)
    canvas.add_text((left, start.y + 2), theme.colour(tint), view.name)
    canvas.pop_clip_rect()
    canvas.add_circle_filled(dot, 3, state)
    canvas.add_text((word, start.y + 2), state, view.state)
    canvas.push_clip_rect(start, (right + PAD, bottom), True)
    canvas.add_text((left, start.y + line + 5), theme.colour(theme.MUTED), _progress(view))
    canvas.pop_clip_rect()
    canvas.add_rect_filled((left, bottom - 6), (right, bottom - 3), theme.colour(theme.TEXT, 0.08), 1.5)
    if view.progress:
        reached = left + view.progress * (right - left)
        canvas.add_rect_filled((left, bottom - 6), (reached, bottom - 3), theme.colour(colour, 0.9), 1.5)


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
