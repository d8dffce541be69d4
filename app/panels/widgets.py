"""The few widgets that all panels share: a slider that resets, lists and buttons, a group header with its reset, labels."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeVar

from avatarrex_studio.panels import theme
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

Item = TypeVar("Item")
Cell = tuple[Callable[[str, theme.Rgb], None], str, theme.Rgb]
"""What draws a text (`caption`, `paragraph`), the text, its colour."""


def room() -> float:
    """Points from the cursor to the right edge."""
    return imgui.get_content_region_avail().x


def fill(spare: float = 0.0) -> None:
    """The next item is as wide as there is room, but for `spare` points."""
    imgui.set_next_item_width(room() - spare)


def slider(
    name: str, value: float, bounds: tuple[float, float], form: str, width: float | None = None, rest: float = 0.0
) -> float | None:
    """The new value while it is dragged or typed (Ctrl+click); a double click gives `rest`; else None.

    A bar from zero to the value: at the left for what begins at zero, else in the middle, whatever the bounds. A click alone
    changes nothing, a drag over the whole width is the whole range, Alt is fine, Shift quick.
    """
    width = room() if width is None else width
    low, high = bounds
    signed = low < 0 < high
    span = 2 * max(-low, high) if signed else (high - low) or 1.0
    _bar(width, *(0.5 * signed + (x - (0.0 if signed else low)) / span for x in (value, rest, low, high)))
    imgui.set_next_item_width(width)
    shown = 0.0 if not any(digit in "123456789" for digit in form % value) else value  # never "-0"
    imgui.push_style_color(imgui.Col_.frame_bg, theme.vec4(theme.PANEL, 0.0))
    imgui.push_style_color(imgui.Col_.frame_bg_hovered, theme.vec4(theme.TEXT, 0.06))
    imgui.push_style_color(imgui.Col_.frame_bg_active, theme.vec4(theme.TEXT, 0.10))
    moved, new = imgui.drag_float(
        f"##{name}", shown, span / max(width, 1.0), low, high, form, imgui.SliderFlags_.clamp_on_input
    )
    imgui.pop_style_color(3)
    if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        imgui.internal.clear_active_id()  # else the second click opens a text
        return rest
    return new if moved else None


def _bar(width: float, value: float, rest: float, low: float, high: float) -> None:
    """The ground of a slider: all are shares of its width; what cannot be reached is darker."""
    draw, place, height = imgui.get_window_draw_list(), imgui.get_cursor_screen_pos(), imgui.get_frame_height()
    if not imgui.is_rect_visible((width, height)):
        return

    def fill(start: float, end: float, colour: int, rounding: float = 4.0) -> None:
        left, right = (place.x + width * min(max(x, 0.0), 1.0) for x in sorted((start, end)))
        draw.add_rect_filled((left, place.y), (right, place.y + height), colour, rounding)

    if low > 0 or high < 1:
        fill(0, 1, theme.colour(theme.UNREACHED))
    fill(low, high, theme.colour(theme.FRAME))
    if value != rest or rest == high:
        fill(low if rest == high else rest, value, theme.colour(theme.ACCENT, 0.42), 2.0)
    if 0 < rest < 1:
        x = place.x + width * rest
        for top in (place.y + 1, place.y + height - 5):  # the text is between
            draw.add_line((x, top), (x, top + 4), theme.colour(theme.MUTED, 0.7))


def choice(
    label: str, names: Iterable[str], shown: str, current: str, tips: Mapping[str, str] | None = None
) -> str | None:
    """A list that drops down, `shown` while it is closed; the name that was picked. `tips`: a tooltip for each name."""
    picked = None
    if imgui.begin_combo(label, shown):
        for name in names:
            if imgui.selectable(name, name == current)[0]:
                picked = name
            if tips and imgui.is_item_hovered():
                imgui.set_tooltip(tips[name])
        imgui.end_combo()
    return picked


def search(key: str, hint: str, text: str, spare: float = 0.0) -> str:
    """A search box; its text."""
    fill(spare)
    return imgui.input_text_with_hint(f"##search.{key}", f"{icons.ICON_FA_MAGNIFYING_GLASS}  {hint}", text)[1]


def tooltip(text: str) -> None:
    """Shown where the mouse rests on the last item."""
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        imgui.set_tooltip(text)


def axis_mark(axis: int) -> None:
    """A thin coloured bar at the left of the last item: red x, green y, blue z."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    imgui.get_window_draw_list().add_rect_filled(low, (low.x + 2, high.y), theme.colour(theme.AXES[axis], 0.85), 1)


def highlight() -> None:
    """A tint behind the row that follows: it is what is selected."""
    low, width = imgui.get_cursor_screen_pos(), room()
    high = (low.x + width, low.y + imgui.get_frame_height() + 2)
    imgui.get_window_draw_list().add_rect_filled((low.x - 4, low.y - 2), high, theme.colour(theme.ACCENT, 0.16), 4)


def label(text: str, width: float, marked: bool = False) -> None:
    """A label of fixed width (at most half the room) before an item that fills the rest; a dot says that it is not at rest."""
    start, width = imgui.get_cursor_pos_x(), min(width, 0.5 * room())
    imgui.align_text_to_frame_padding()
    if marked:
        place = imgui.get_cursor_screen_pos()
        centre = (place.x + 2, place.y + imgui.get_frame_height() / 2)
        imgui.get_window_draw_list().add_circle_filled(centre, 2.5, theme.colour(theme.ACCENT))
    imgui.set_cursor_pos_x(start + 9)
    caption(text, theme.TEXT if marked else theme.MUTED)
    imgui.same_line(start + width)
    fill()


def group(title: str, key: str, marked: bool = False, opened: bool = True) -> tuple[bool, bool]:
    """A collapsible group; whether it is open, and whether its reset was pressed (there is one where it is `marked`)."""
    right = imgui.get_cursor_pos_x() + room()
    imgui.set_next_item_allow_overlap()
    flags = imgui.TreeNodeFlags_.default_open if opened else 0
    is_open = imgui.collapsing_header(f"{title}###{key}", flags | imgui.TreeNodeFlags_.allow_overlap)
    pressed = False
    if marked:
        imgui.same_line(right - imgui.calc_text_size(icons.ICON_FA_ROTATE_LEFT).x - 12)
        with imgui_ctx.push_style_color(imgui.Col_.button, theme.vec4(theme.ACCENT, 0.0)):
            pressed = imgui.small_button(f"{icons.ICON_FA_ROTATE_LEFT}##reset.{key}")
        if imgui.is_item_hovered():
            imgui.set_tooltip(f"Reset {title.lower()}")
    return is_open, pressed


def caption(text: str, colour: theme.Rgb = theme.MUTED) -> None:
    """A line of text, muted unless told."""
    with imgui_ctx.push_style_color(imgui.Col_.text, theme.vec4(colour)):
        imgui.text(text)


def paragraph(text: str, colour: theme.Rgb = theme.MUTED) -> None:
    """Text over as many lines as it takes, muted unless told."""
    with imgui_ctx.push_style_color(imgui.Col_.text, theme.vec4(colour)):
        imgui.text_wrapped(text)


def in_rows(items: Iterable[Item], gap: float = -1.0, columns: int = 1000) -> Iterator[Item]:
    """`items` for a loop that draws each: `columns` beside one another, `gap` points between them (the style's)."""
    for number, item in enumerate(items):
        if number % columns:
            imgui.same_line(0, gap)
        yield item


def columns(minimum: float, gap: float, most: int = 1000) -> tuple[int, float]:
    """How many columns of at least `minimum` points there is room for, at most `most`, and the width of each."""
    number = max(1, min(most, int((room() + gap) / (minimum + gap))))
    return number, (room() - gap * (number - 1)) / number


def button_grid(titles: Mapping[str, str], minimum: float, key: str = "") -> str | None:
    """Buttons of equal width in as many columns as fit, titles by name; the name that was pressed. `key` begins their ids."""
    number, width = columns(minimum, imgui.get_style().item_spacing.x)
    pressed = None
    for name, title in in_rows(titles.items(), columns=number):
        if imgui.button(f"{title}##{key}{name}", (width, 0)):
            pressed = name
    return pressed


def table(name: str, flags: int, rows: Iterable[tuple[Cell, Cell]], first: float = 0.0) -> None:
    """A table of two columns; `first`: points of the first, the second takes the rest."""
    if not imgui.begin_table(name, 2, flags):
        return
    if first:
        imgui.table_setup_column("name", imgui.TableColumnFlags_.width_fixed, first)
        imgui.table_setup_column("value", imgui.TableColumnFlags_.width_stretch)
    for draw, text, colour in itertools.chain.from_iterable(rows):
        imgui.table_next_column()
        draw(text, colour)
    imgui.end_table()
