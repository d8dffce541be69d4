"""The Performance panel: the level and its error, times of surface and exact picture, what was worked and kept, memory.

It reads what the studio keeps anyway and computes only while it is drawn. Milliseconds, MiB.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

from avatarrex_studio.engine.request import Picture
from avatarrex_studio.engine.skips import WORK, skipped
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.engine.work import Work
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.status import condition
from avatarrex_studio.session.commands import Command, SetLevel
from avatarrex_studio.session.state import AUTO, LEVELS, LIVE
from imgui_bundle import imgui

from avatarrex.levels import ABOUT
from avatarrex.reference.level_errors import level_errors
from avatarrex.surface.surface import Surface
from avatarrex.volume.memory import Memory

LABEL = 90.0
NOT_MEASURED = "not measured"
COLUMN = 62.0
"""Width of a column of figures, points."""
STAGES = ("templates", "volume", "pointmap", "shading")
LEVEL_TEXT = {AUTO: "at rest balanced, then quality where it takes less than ten seconds", **ABOUT}
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
    "bytes_uploaded": "Bytes uploaded",
    "bytes_read_back": "Bytes read back",
}
"""Counters and their titles, those of what a picture may skip first."""


def draw(studio: Studio) -> Iterator[Command]:
    """Draw the panel; the commands of this frame."""
    yield from _level(studio)
    _rates(studio)
    picture = studio.pictures.picture
    if picture is None:
        widgets.caption("No exact picture yet.")
        return
    _times(studio, picture)
    _work(picture.work)
    _memory(picture.work.memory)


def error_text(name: str, surface: Surface | None = None) -> str:
    """The measured depth error of a level, in words; that of `live` is what the avatar's own surface says."""
    if name == LIVE and surface is not None:
        return error_words(surface.meta.get("live.depth_mm"), surface.meta.get("live.depth_p99_mm"))
    error = level_errors().get(name)
    return error_words(error.depth_mean_mm, error.depth_p99_mm) if error else NOT_MEASURED


def error_words(mean: object, p99: object) -> str:
    """Both in millimetres; what is no number was not measured."""
    if not isinstance(mean, int | float) or not isinstance(p99, int | float):
        return NOT_MEASURED
    return f"mean {mean:.3g} mm, p99 {p99:.3g} mm"


def _level(studio: Studio) -> Iterator[Command]:
    current, picture = studio.state.level, studio.pictures.picture
    made = picture.work.level if picture else AUTO
    widgets.label("Level", LABEL)
    shown = f"{AUTO}: {made}" if current == AUTO and picture else current
    picked = widgets.choice("##level", LEVELS, shown, current, LEVEL_TEXT)
    widgets.paragraph(LEVEL_TEXT[current])
    widgets.label("Depth error", LABEL)
    avatar = studio.avatars.ready(studio.state.avatar)
    imgui.text(error_text(made if current == AUTO else current, avatar.surface if avatar else None))
    if picked:
        yield SetLevel(picked)


def _rates(studio: Studio) -> None:
    imgui.separator_text("On screen")
    widgets.label("Interface", LABEL)
    imgui.text(f"{imgui.get_io().framerate:.0f} fps")
    widgets.label("Live", LABEL)
    if studio.surface is None or studio.live is None:
        imgui.text("no surface")
        return
    imgui.text("   ".join(f"{name} {value:.1f} ms" for name, value in studio.live.ms.items()))


def _times(studio: Studio, picture: Picture) -> None:
    imgui.separator_text("Exact picture")
    work, history = picture.work, studio.pictures.history
    total = work.ms["total"]
    height, width = picture.image.shape[:2]
    imgui.text(f"{total:.0f} ms" if total >= 10 else f"{total:.1f} ms")
    imgui.same_line(0, 14)
    imgui.text(f"{1e3 / total:.1f} fps" if total > 0 else "- fps")
    imgui.same_line(0, 14)
    widgets.caption(", ".join(filter(None, (f"{width} × {height}", work.level, condition(studio)))))
    middle = {name: median(ms[name] for ms in history or (work.ms,)) for name in (*STAGES, "total")}
    longest = max(1e-6, *(max(work.ms[name], middle[name]) for name in STAGES))
    right = imgui.get_cursor_pos_x() + widgets.room()
    _figures(("last", f"median {len(history)}"), right, theme.MUTED)
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


def _memory(memory: Memory) -> None:
    imgui.separator_text("Volume")
    sizes = {"Body grid": memory.body, "Bricks": memory.bricks, "Part boxes": memory.parts, "Together": memory.total}
    for title, size in sizes.items():
        widgets.label(title, LABEL)
        imgui.text(f"{size / 2**20:.2f} MiB")
