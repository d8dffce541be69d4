"""The look: a calm interface with one accent colour, dark or light; fonts and spacing. Colours are sRGB in [0, 1].

Colours are named as the dark theme has them; the light one replaces each as it is drawn (`LIGHT`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
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
CURVES = (
    ACCENT, (0.96, 0.64, 0.33), (0.47, 0.79, 0.50), (0.85, 0.50, 0.78), (0.91, 0.81, 0.42),
    (0.38, 0.80, 0.80), (0.93, 0.46, 0.46), (0.62, 0.57, 0.96),
)  # fmt: skip
"""Of runs and of loss terms, the accent first."""
CLIP, KEYS, LIVE = (0.25, 0.45, 0.68), (0.93, 0.72, 0.33), (0.40, 0.66, 0.42)
"""Of layers of the timeline."""
RUNNING = CURVES[2]
BASE = (0.094, 0.102, 0.118)
"""Behind panels and curves."""
PANEL = (0.118, 0.129, 0.149)
FRAME = (0.169, 0.184, 0.212)
UNREACHED = (0.137, 0.149, 0.172)
"""Of a slider what its limits exclude."""
RAISED = (0.212, 0.231, 0.267)
ALARM = (0.16, 0.09, 0.09)
"""Behind an error over the picture."""
_POPUP, _BORDER, _PRESSED, _GRAB, _GRAB_OVER = (
    (0.137, 0.149, 0.173),
    (0.06, 0.065, 0.075),
    (0.25, 0.27, 0.31),
    (0.26, 0.28, 0.32),
    (0.32, 0.35, 0.40),
)
_SLIDER, _OVER, _HEADER, _LINE = (0.52, 0.58, 0.68), (0.27, 0.30, 0.35), (0.153, 0.169, 0.196), (0.18, 0.195, 0.225)
LIGHT: dict[Rgb, Rgb] = {
    ACCENT: (0.09, 0.42, 0.82),
    TEXT: (0.12, 0.13, 0.15),
    MUTED: (0.38, 0.41, 0.46),
    ERROR: (0.75, 0.14, 0.11),
    WARNING: (0.60, 0.39, 0.02),
    CURVES[1]: (0.74, 0.36, 0.03),
    CURVES[2]: (0.13, 0.49, 0.20),
    CURVES[3]: (0.65, 0.20, 0.57),
    CURVES[4]: (0.52, 0.43, 0.02),
    CURVES[5]: (0.02, 0.46, 0.50),
    CURVES[6]: (0.78, 0.17, 0.19),
    CURVES[7]: (0.38, 0.31, 0.80),
    CLIP: (0.45, 0.63, 0.86),
    KEYS: (0.66, 0.41, 0.02),
    LIVE: (0.16, 0.47, 0.20),
    BASE: (0.865, 0.875, 0.89),
    PANEL: (0.94, 0.945, 0.955),
    FRAME: (0.85, 0.862, 0.88),
    UNREACHED: (0.90, 0.908, 0.92),
    RAISED: (0.80, 0.815, 0.84),
    ALARM: (0.99, 0.92, 0.91),
    _POPUP: (0.97, 0.973, 0.98),
    _BORDER: (0.74, 0.76, 0.79),
    _PRESSED: (0.78, 0.80, 0.83),
    _GRAB: (0.70, 0.72, 0.75),
    _GRAB_OVER: (0.62, 0.64, 0.68),
    _SLIDER: (0.45, 0.50, 0.58),
    _OVER: (0.74, 0.76, 0.80),
    _HEADER: (0.885, 0.893, 0.907),
    _LINE: (0.80, 0.81, 0.83),
}
"""The light theme's colour for each of the dark one."""
SIZES: dict[str, Size] = {
    "window_padding": (10, 10), "frame_padding": (8, 4), "item_spacing": (8, 6), "item_inner_spacing": (6, 4),
    "scrollbar_size": 11, "grab_min_size": 7, "window_rounding": 6, "popup_rounding": 6, "frame_rounding": 4,
    "grab_rounding": 4, "tab_rounding": 4, "scrollbar_rounding": 6, "window_border_size": 0, "frame_border_size": 0,
    "popup_border_size": 1, "tab_bar_border_size": 0, "window_title_align": (0.02, 0.5),
}  # fmt: skip
COLOURS: dict[str, Rgba] = {
    "text": (*TEXT, 1), "text_disabled": (*MUTED, 1), "window_bg": (*PANEL, 1), "child_bg": (*PANEL, 0),
    "popup_bg": (*_POPUP, 0.98), "border": (*_BORDER, 1), "frame_bg": (*FRAME, 1),
    "frame_bg_hovered": (*RAISED, 1), "frame_bg_active": (*_PRESSED, 1), "title_bg": (*BASE, 1),
    "title_bg_active": (*BASE, 1), "title_bg_collapsed": (*BASE, 1), "menu_bar_bg": (*BASE, 1),
    "scrollbar_bg": (*PANEL, 0), "scrollbar_grab": (*_GRAB, 1),
    "scrollbar_grab_hovered": (*_GRAB_OVER, 1), "scrollbar_grab_active": (*ACCENT, 1),
    "check_mark": (*ACCENT, 1),
    "slider_grab": (*_SLIDER, 0.55), "slider_grab_active": (*ACCENT, 0.8),
    "button": (*RAISED, 1), "button_hovered": (*_OVER, 1), "button_active": (*ACCENT, 0.75),
    "header": (*_HEADER, 1), "header_hovered": (*RAISED, 1), "header_active": (*ACCENT, 0.45),
    "separator": (*_LINE, 1),
    "separator_hovered": (*ACCENT, 0.6), "separator_active": (*ACCENT, 1),
    "resize_grip": (*PANEL, 0), "resize_grip_hovered": (*ACCENT, 0.5), "resize_grip_active": (*ACCENT, 1),
    "tab": (*BASE, 1), "tab_hovered": (*RAISED, 1), "tab_selected": (*PANEL, 1),
    "tab_selected_overline": (*ACCENT, 1), "tab_dimmed": (*BASE, 1), "tab_dimmed_selected": (*PANEL, 1),
    "tab_dimmed_selected_overline": (*ACCENT, 0.5), "docking_preview": (*ACCENT, 0.4),
    "docking_empty_bg": (*BASE, 1), "text_selected_bg": (*ACCENT, 0.35), "nav_cursor": (*ACCENT, 0.8),
    "modal_window_dim_bg": (0.02, 0.02, 0.03, 0.55),
}  # fmt: skip


class _Present:
    """The theme that is used."""

    light = False


def use(name: str) -> None:
    """`dark` or `light`, from the next frame on, for all that is drawn."""
    if _Present.light != (name == "light"):
        _Present.light = name == "light"
        apply_style()


def shade(rgb: Rgb) -> Rgb:
    """A colour of the dark theme as the present one has it."""
    return LIGHT.get(rgb, rgb) if _Present.light else rgb


def load_fonts() -> None:
    """Roboto with the icons of Font Awesome."""
    hello_imgui.load_font_ttf_with_font_awesome_icons(FONT, FONT_SIZE)


def apply_style() -> None:
    """Spacing and colours of every widget."""
    (imgui.style_colors_light if _Present.light else imgui.style_colors_dark)()
    imgui.get_style().window_menu_button_position = imgui.Dir.none
    dress(imgui.get_style(), imgui.Col_, SIZES, COLOURS)


def dress(style: Any, names: Any, sizes: Mapping[str, Size], colours: Mapping[str, Rgba]) -> None:
    """Set sizes (points) and colours of a style by name; `names`: its enumeration of colours."""
    for name, size in sizes.items():
        setattr(style, name, imgui.ImVec2(*size) if isinstance(size, tuple) else size)
    for name, value in colours.items():
        red, green, blue, alpha = value
        style.set_color_(getattr(names, name), imgui.ImVec4(*shade((red, green, blue)), alpha))


def window_background(alpha: float) -> None:
    """How opaque windows are from here on: what is drawn twice over all of the screen takes 5 ms in software."""
    imgui.get_style().set_color_(imgui.Col_.window_bg, vec4(PANEL, alpha))


def colour(rgb: Rgb, alpha: float = 1.0) -> int:
    """Packed colour for draw lists."""
    return imgui.get_color_u32(vec4(rgb, alpha))


def vec4(rgb: Rgb, alpha: float = 1.0) -> imgui.ImVec4:
    """The same for style and text calls."""
    return _vec4(shade(rgb), alpha)


@lru_cache(4096)  # a frame needs some hundred
def _vec4(rgb: Rgb, alpha: float) -> imgui.ImVec4:
    return imgui.ImVec4(*rgb, alpha)
