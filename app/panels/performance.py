"""The Performance panel: the level and its error, time per stage, what was worked and what was kept, memory of the volume.

It reads what the studio keeps anyway and computes only while it is drawn. Milliseconds, MiB.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

from avatarrex_studio.engine.skips import WORK, skipped
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.engine.work import Work
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.session.commands import Command, SetLevel
from avatarrex_studio.session.state import AUTO, LEVELS
from imgui_bundle import imgui

from avatarrex.frame import DeferredFrame
from avatarrex.levels import ABOUT
from avatarrex.reference.level_errors import level_errors
from avatarrex.volume.memory import memory_of

LABEL = 90.0
COLUMN = 62.0
"""Width of a column of figures, points."""
STAGES = ("templates", "volume", "pointmap", "shading")
LEVEL_TEXT = {AUTO: "the most exact level that the time at hand allows", **ABOUT}
COUNTERS = {
    "templates_posed": "Meshes posed",
    "voxels_evaluated": "Body voxels",
    "hand_distances": "Hand distances",
    "face_evaluations": "Face field",
    "unet_runs": "U-Nets run",
    "patches_decoded": "Patches decoded",
    "rays": "Rays",
    "pixels_shaded": "Pixels shaded",
    "local_mlp_evaluations": "Local MLPs",
    "ray_steps": "Ray steps",
    "body_pixels": "Body pixels",
    "hand_pixels": "Hand pixels",
    "face_pixels": "Face pixels",
    "surface_vertices": "Surface vertices",
    "surface_triangles": "Surface triangles",
    "bytes_uploaded": "Bytes uploaded",
    "bytes_read_back": "Bytes read back",
}
"""Counters and their titles, those of what a picture may skip first."""


def draw(studio: Studio) -> Iterator[Command]:
    """Draw the panel; the commands of this frame."""
    yield from _level(studio)
    if studio.work is None:
        widgets.caption("No picture yet.")
        return
    _times(studio, studio.work)
    _work(studio.work)
    if isinstance(studio.engine.last, DeferredFrame):
        _memory(studio.engine.last)


def error_text(name: str) -> str:
    """The measured depth error of a level, in words."""
    error = level_errors().get(name)
    if error is None:
        return "not measured"
    return f"mean {error.depth_mean_mm:.3g} mm, p99 {error.depth_p99_mm:.3g} mm"


def _level(studio: Studio) -> Iterator[Command]:
    current = studio.state.level
    widgets.label("Level", LABEL)
    shown = f"{AUTO}: {studio.level}" if current == AUTO else current
    picked = widgets.choice("##level", LEVELS, shown, current, LEVEL_TEXT)
    widgets.paragraph(LEVEL_TEXT[current])
    widgets.label("Depth error", LABEL)
    imgui.text(error_text(studio.level if current == AUTO else current))
    if picked:
        yield SetLevel(picked)


def _times(studio: Studio, work: Work) -> None:
    imgui.separator_text("Last picture")
    total = work.ms["total"]
    width, height = studio.size
    imgui.text(f"{total:.0f} ms" if total >= 10 else f"{total:.1f} ms")
    imgui.same_line(0, 14)
    imgui.text(f"{1e3 / total:.1f} fps" if total > 0 else "- fps")
    imgui.same_line(0, 14)
    widgets.caption(f"{width} × {height}, {work.level}")
    middle = {name: median(ms[name] for ms in studio.history or (work.ms,)) for name in (*STAGES, "total")}
    longest = max(1e-6, *(max(work.ms[name], middle[name]) for name in STAGES))
    right = imgui.get_cursor_pos_x() + widgets.room()
    _figures(("last", f"median {len(studio.history)}"), right, theme.MUTED)
    for name in STAGES:
        widgets.label(name.capitalize(), LABEL)
        _bar(work.ms[name] / longest, middle[name] / longest, right - 2 * COLUMN - imgui.get_cursor_pos_x() - 6)
        _figures((f"{work.ms[name]:.1f}", f"{middle[name]:.1f}"), right)
    widgets.label("Total", LABEL)
    _figures((f"{total:.1f}", f"{middle['total']:.1f}"), right)


def _bar(share: float, mark: float, width: float) -> None:
    """A bar of `share` of the width, with a tick at the share `mark`."""
    place, height, pen = imgui.get_cursor_screen_pos(), imgui.get_frame_height(), imgui.get_window_draw_list()
    width = max(width, 8.0)
    top, bottom = place.y + 0.25 * height, place.y + 0.75 * height
    pen.add_rect_filled((place.x, top), (place.x + width, bottom), theme.colour(theme.MUTED, 0.15), 2)
    if share > 0:
        pen.add_rect_filled((place.x, top), (place.x + max(share * width, 1), bottom), theme.colour(theme.ACCENT), 2)
    tick = place.x + mark * (width - 2)
    pen.add_rect_filled((tick, top - 2), (tick + 2, bottom + 2), theme.colour(theme.TEXT, 0.8))
    imgui.dummy((width, height))
    imgui.same_line()


def _figures(texts: tuple[str, ...], right: float, colour: theme.Rgb = theme.TEXT) -> None:
    """Texts that end at the right edge, a column each."""
    for number, text in enumerate(texts, 1 - len(texts)):
        imgui.set_cursor_pos_x(right + number * COLUMN - imgui.calc_text_size(text).x)
        widgets.caption(text, colour)
        if number:
            imgui.same_line()


def _work(work: Work) -> None:
    imgui.separator_text("Work")
    reasons = {WORK[name]: reason for name, reason in skipped(work).items()}
    rows = (_row(title, work.counters[counter], reasons.get(counter)) for counter, title in COUNTERS.items())
    widgets.table("work", imgui.TableFlags_.row_bg, rows, LABEL + 24)


def _row(title: str, count: int, reason: str | None) -> tuple[widgets.Cell, widgets.Cell]:
    colour = theme.TEXT if count else theme.MUTED
    number = (widgets.caption, f"{count:,}".replace(",", " "), colour)
    return (widgets.caption, title, colour), (widgets.paragraph, reason, theme.MUTED) if reason else number


def _memory(frame: DeferredFrame) -> None:
    imgui.separator_text("Volume")
    memory = memory_of(frame.volume.sdf)
    sizes = {"Body grid": memory.body, "Bricks": memory.bricks, "Part boxes": memory.parts, "Together": memory.total}
    for title, size in sizes.items():
        widgets.label(title, LABEL)
        imgui.text(f"{size / 2**20:.2f} MiB")
