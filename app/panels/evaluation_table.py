"""Evaluations beside one another: a row for each subject, the best of each measure marked."""

from __future__ import annotations

from collections.abc import Sequence

from avatarrex_studio.jobs.evaluations import MEASURES, Row
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import imgui

TITLES = ("Run", "Step", "Subject", *(title for title, _ in MEASURES.values()), "Pictures")


def draw(rows: Sequence[Row]) -> None:
    """Draw the table."""
    best = {
        title: max((row.values[title] for row in rows), key=_number)
        for title, _ in MEASURES.values()
        if title != "Sharp"
    }
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit | imgui.TableFlags_.scroll_x
    height = (len(rows) + 1) * imgui.get_text_line_height_with_spacing() + 22
    if not imgui.begin_table("##evaluations", len(TITLES), flags, imgui.ImVec2(0, height)):
        return
    for title in TITLES:
        imgui.table_setup_column(title)
    imgui.table_headers_row()
    for row in rows:
        for title, text in zip(TITLES, (row.run, row.step, row.subject, *row.values.values(), str(row.pictures))):
            imgui.table_next_column()
            widgets.caption(text, theme.ACCENT if best.get(title) == text and len(rows) > 1 else theme.TEXT)
    imgui.end_table()


def _number(text: str) -> float:
    return float("-inf") if text == "–" else float(text)
