"""The few widgets that all panels share: a slider that resets, a group header with its reset, a marked label."""

from __future__ import annotations

from avatarrex_studio.panels import theme
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui


def slider(
    name: str, value: float, low: float, high: float, form: str, width: float, rest: float = 0.0, tip: str = ""
) -> float | None:
    """The new value while it is dragged or typed (Ctrl+click); a double click gives `rest`; else None."""
    imgui.set_next_item_width(width)
    zero = float((form.partition("f")[0] + "f") % value) == 0  # never "-0"
    shown = 0.0 if zero else value
    moved, new = imgui.slider_float(f"##{name}", shown, low, high, form)
    if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        imgui.internal.clear_active_id()  # else the held button drags it to the cursor again
        return rest
    if tip and imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        imgui.set_tooltip(tip)
    return new if moved else None


def axis_mark(axis: int) -> None:
    """A thin coloured bar at the left of the last item: red x, green y, blue z."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    imgui.get_window_draw_list().add_rect_filled(
        low, imgui.ImVec2(low.x + 2, high.y), theme.colour(theme.AXES[axis], 0.85), 1
    )


def label(text: str, marked: bool, width: float) -> None:
    """A label of fixed width before a slider; an accent colour and dot say that the value is not at rest."""
    start = imgui.get_cursor_pos_x()
    imgui.align_text_to_frame_padding()
    if marked:
        place = imgui.get_cursor_screen_pos()
        height = imgui.get_frame_height()
        centre = imgui.ImVec2(place.x + 2, place.y + height / 2)
        imgui.get_window_draw_list().add_circle_filled(centre, 2.5, theme.colour(theme.ACCENT))
    imgui.set_cursor_pos_x(start + 9)
    imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.TEXT if marked else theme.MUTED))
    imgui.text(text)
    imgui.pop_style_color()
    imgui.same_line(start + width)


def group(title: str, key: str, marked: bool, opened: bool = True) -> tuple[bool, bool]:
    """A collapsible group; returns whether it is open and whether its reset was pressed."""
    right = imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x
    imgui.set_next_item_allow_overlap()
    flags = imgui.TreeNodeFlags_.default_open if opened else 0
    is_open = imgui.collapsing_header(f"{title}###{key}", flags | imgui.TreeNodeFlags_.allow_overlap)
    pressed = False
    if marked:
        width = imgui.calc_text_size(icons.ICON_FA_ROTATE_LEFT).x + 12
        imgui.same_line(right - width)
        imgui.push_style_color(imgui.Col_.button, theme.vec4(theme.ACCENT, 0.0))
        pressed = imgui.small_button(f"{icons.ICON_FA_ROTATE_LEFT}##reset.{key}")
        imgui.pop_style_color()
        if imgui.is_item_hovered():
            imgui.set_tooltip(f"Reset {title.lower()}")
    return is_open, pressed


def caption(text: str) -> None:
    """A small muted heading."""
    imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.MUTED))
    imgui.text(text)
    imgui.pop_style_color()


def button_grid(names: list[tuple[str, str]], minimum: float) -> str | None:
    """Buttons of equal width in as many columns as fit, (id, title) each; the id that was pressed."""
    available, gap = imgui.get_content_region_avail().x, imgui.get_style().item_spacing.x
    columns = max(1, int((available + gap) / (minimum + gap)))
    width = (available - gap * (columns - 1)) / columns
    pressed = None
    for number, (key, title) in enumerate(names):
        if number % columns:
            imgui.same_line()
        if imgui.button(f"{title}##{key}", imgui.ImVec2(width, 0)):
            pressed = key
    return pressed
