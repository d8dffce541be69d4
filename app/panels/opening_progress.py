"""That something is being read, over the viewport's lower left, with Cancel."""

from __future__ import annotations

from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.export_progress import FLAGS, GAP, WIDTH
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx


def draw(words: str, low: tuple[float, float], high: tuple[float, float]) -> bool:
    """Draw it into a rectangle of the screen, above a running export; whether *Cancel* was pressed."""
    width = min(WIDTH, high[0] - low[0] - 2 * GAP)
    if width < 120:
        return False
    exporting = imgui.internal.find_window_by_name("Exporting")
    top = exporting.pos.y if exporting is not None and exporting.active else high[1]
    imgui.set_next_window_pos((low[0] + GAP, top - GAP), imgui.Cond_.always, (0.0, 1.0))
    imgui.set_next_window_size_constraints((width, 0), (width, 200))
    with (
        imgui_ctx.push_style_color(imgui.Col_.window_bg, theme.vec4(theme.RAISED, 0.97)),
        imgui_ctx.begin("Reading", None, FLAGS),
    ):
        widgets.caption(f"{icons.ICON_FA_FOLDER_OPEN}  {words[0].upper()}{words[1:]}", theme.TEXT)
        imgui.progress_bar(-imgui.get_time(), (widgets.room() - 96, 0), "")
        imgui.same_line()
        return bool(imgui.button("Cancel###cancel.reading", (-1, 0)))
