"""The look: a dark, calm interface with one accent colour; fonts and spacing. Colours are sRGB in [0, 1]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imgui_bundle import hello_imgui, imgui

Rgb = tuple[float, float, float]
Rgba = tuple[float, float, float, float]
Size = float | tuple[float, float]
ACCENT = (0.31, 0.63, 0.98)
AXES = ((0.87, 0.38, 0.38), (0.47, 0.75, 0.42), (0.38, 0.56, 0.92))
"""x, y, z."""
TEXT = (0.88, 0.89, 0.91)
MUTED = (0.56, 0.59, 0.64)
ERROR = (0.96, 0.44, 0.40)
WARNING = (0.95, 0.75, 0.35)
FONT = "fonts/Roboto/Roboto-Regular.ttf"
FONT_SIZE = 15.0
_BASE = (0.094, 0.102, 0.118)
PANEL = (0.118, 0.129, 0.149)
FRAME = (0.169, 0.184, 0.212)
UNREACHED = (0.137, 0.149, 0.172)
"""Of a slider what its limits exclude."""
RAISED = (0.212, 0.231, 0.267)
SIZES: dict[str, Size] = {
    "window_padding": (10, 10), "frame_padding": (8, 4), "item_spacing": (8, 6), "item_inner_spacing": (6, 4),
    "scrollbar_size": 11, "grab_min_size": 7, "window_rounding": 6, "popup_rounding": 6, "frame_rounding": 4,
    "grab_rounding": 4, "tab_rounding": 4, "scrollbar_rounding": 6, "window_border_size": 0, "frame_border_size": 0,
    "popup_border_size": 1, "tab_bar_border_size": 0, "window_title_align": (0.02, 0.5),
}  # fmt: skip
COLOURS: dict[str, Rgba] = {
    "text": (*TEXT, 1), "text_disabled": (*MUTED, 1), "window_bg": (*PANEL, 1), "child_bg": (*PANEL, 0),
    "popup_bg": (0.137, 0.149, 0.173, 0.98), "border": (0.06, 0.065, 0.075, 1), "frame_bg": (*FRAME, 1),
    "frame_bg_hovered": (*RAISED, 1), "frame_bg_active": (0.25, 0.27, 0.31, 1), "title_bg": (*_BASE, 1),
    "title_bg_active": (*_BASE, 1), "title_bg_collapsed": (*_BASE, 1), "menu_bar_bg": (*_BASE, 1),
    "scrollbar_bg": (*PANEL, 0), "scrollbar_grab": (0.26, 0.28, 0.32, 1),
    "scrollbar_grab_hovered": (0.32, 0.35, 0.40, 1), "scrollbar_grab_active": (*ACCENT, 1),
    "check_mark": (*ACCENT, 1),
    "slider_grab": (0.52, 0.58, 0.68, 0.55), "slider_grab_active": (*ACCENT, 0.8),
    "button": (*RAISED, 1), "button_hovered": (0.27, 0.30, 0.35, 1), "button_active": (*ACCENT, 0.75),
    "header": (0.153, 0.169, 0.196, 1), "header_hovered": (*RAISED, 1), "header_active": (*ACCENT, 0.45),
    "separator": (0.18, 0.195, 0.225, 1),
    "separator_hovered": (*ACCENT, 0.6), "separator_active": (*ACCENT, 1),
    "resize_grip": (*PANEL, 0), "resize_grip_hovered": (*ACCENT, 0.5), "resize_grip_active": (*ACCENT, 1),
    "tab": (*_BASE, 1), "tab_hovered": (*RAISED, 1), "tab_selected": (*PANEL, 1),
    "tab_selected_overline": (*ACCENT, 1), "tab_dimmed": (*_BASE, 1), "tab_dimmed_selected": (*PANEL, 1),
    "tab_dimmed_selected_overline": (*ACCENT, 0.5), "docking_preview": (*ACCENT, 0.4),
    "docking_empty_bg": (*_BASE, 1), "text_selected_bg": (*ACCENT, 0.35), "nav_cursor": (*ACCENT, 0.8),
    "modal_window_dim_bg": (0.02, 0.02, 0.03, 0.55),
}  # fmt: skip


def load_fonts() -> None:
    """Roboto with the icons of Font Awesome."""
    hello_imgui.load_font_ttf_with_font_awesome_icons(FONT, FONT_SIZE)


def apply_style() -> None:
    """Spacing and colours of every widget."""
    imgui.style_colors_dark()
    imgui.get_style().window_menu_button_position = imgui.Dir.none
    dress(imgui.get_style(), imgui.Col_, SIZES, COLOURS)


def dress(style: Any, names: Any, sizes: Mapping[str, Size], colours: Mapping[str, Rgba]) -> None:
    """Set sizes (points) and colours of a style by name; `names`: its enumeration of colours."""
    for name, size in sizes.items():
        setattr(style, name, imgui.ImVec2(*size) if isinstance(size, tuple) else size)
    for name, value in colours.items():
        style.set_color_(getattr(names, name), imgui.ImVec4(*value))


def window_background(alpha: float) -> None:
    """How opaque windows are from here on: what is drawn twice over all of the screen takes 5 ms in software."""
    imgui.get_style().set_color_(imgui.Col_.window_bg, vec4(PANEL, alpha))


def colour(rgb: Rgb, alpha: float = 1.0) -> int:
    """Packed colour for draw lists."""
    return imgui.get_color_u32(imgui.ImVec4(*rgb, alpha))


def vec4(rgb: Rgb, alpha: float = 1.0) -> imgui.ImVec4:
    """The same for style and text calls."""
    return imgui.ImVec4(*rgb, alpha)
