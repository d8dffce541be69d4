"""How far the export is, over the viewport's lower left: a bar, what is left, and Cancel."""

from __future__ import annotations

from avatarrex_studio.jobs.exporting import Progress
from avatarrex_studio.jobs.run_view import duration
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

WIDTH, GAP = 330.0, 10.0
FLAGS = (
    imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_focus_on_appearing | imgui.WindowFlags_.no_nav | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.always_auto_resize
)  # fmt: skip


def words(progress: Progress) -> str:
    """How far it is, in a line."""
    if progress.cancelling:
        return "cancelling…"
    if not progress.done:
        return "preparing…" if progress.steps > 1 else "rendering…"
    left = f", {duration(progress.seconds)} left" if progress.seconds is not None else ""
    return f"{progress.done:,} of {progress.steps:,}{left}"


def draw(progress: Progress, low: tuple[float, float], high: tuple[float, float]) -> bool:
    """Draw it into a rectangle of the screen; whether *Cancel* was pressed."""
    width = min(WIDTH, high[0] - low[0] - 2 * GAP)
    if width < 120:
        return False
    imgui.set_next_window_pos((low[0] + GAP, high[1] - GAP), imgui.Cond_.always, (0.0, 1.0))
    imgui.set_next_window_size_constraints((width, 0), (width, 200))
    with (
        imgui_ctx.push_style_color(imgui.Col_.window_bg, theme.vec4(theme.RAISED, 0.97)),
        imgui_ctx.begin("Exporting", None, FLAGS),
    ):
        more = f"   and {progress.waiting} more" if progress.waiting else ""
        widgets.caption(f"{icons.ICON_FA_FILE_EXPORT}  {progress.path.name}{more}", theme.TEXT)
        widgets.caption(words(progress))
        share = progress.done / progress.steps if progress.steps > 1 else -imgui.get_time()
        imgui.progress_bar(share, (widgets.room() - 96, 0), "")
        imgui.same_line()
        imgui.begin_disabled(progress.cancelling)
        pressed = imgui.button("Cancel###cancel", (-1, 0))
        imgui.end_disabled()
    return pressed
