"""The look: a dark, calm interface with one accent colour; fonts and spacing. Colours are sRGB in [0, 1]."""

from __future__ import annotations

from imgui_bundle import hello_imgui, imgui

Rgb = tuple[float, float, float]
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
_FRAME = (0.169, 0.184, 0.212)
_RAISED = (0.212, 0.231, 0.267)


def load_fonts() -> None:
    """Roboto with the icons of Font Awesome."""
    hello_imgui.load_font_ttf_with_font_awesome_icons(FONT, FONT_SIZE)


def apply_style() -> None:
    """Spacing and colours of every widget."""
    style = imgui.get_style()
    imgui.style_colors_dark()
    style.window_padding = imgui.ImVec2(10, 10)
    style.frame_padding = imgui.ImVec2(8, 4)
    style.item_spacing = imgui.ImVec2(8, 6)
    style.item_inner_spacing = imgui.ImVec2(6, 4)
    style.scrollbar_size = 11
    style.grab_min_size = 7
    style.window_menu_button_position = imgui.Dir.none
    style.window_rounding = style.popup_rounding = 6
    style.frame_rounding = style.grab_rounding = style.tab_rounding = 4
    style.scrollbar_rounding = 6
    style.window_border_size = style.frame_border_size = 0
    style.popup_border_size = 1
    style.tab_bar_border_size = 0
    style.window_title_align = imgui.ImVec2(0.02, 0.5)
    for name, colour in _colours().items():
        style.set_color_(getattr(imgui.Col_, name), imgui.ImVec4(*colour))


def _colours() -> dict[str, tuple[float, float, float, float]]:
    def over(colour: Rgb, alpha: float = 1.0) -> tuple[float, float, float, float]:
        return (*colour, alpha)

    return {
        "text": over(TEXT), "text_disabled": over(MUTED), "window_bg": over(PANEL), "child_bg": over(PANEL, 0),
        "popup_bg": over((0.137, 0.149, 0.173), 0.98), "border": over((0.06, 0.065, 0.075)), "frame_bg": over(_FRAME),
        "frame_bg_hovered": over(_RAISED), "frame_bg_active": over((0.25, 0.27, 0.31)), "title_bg": over(_BASE),
        "title_bg_active": over(_BASE), "title_bg_collapsed": over(_BASE), "menu_bar_bg": over(_BASE),
        "scrollbar_bg": over(PANEL, 0), "scrollbar_grab": over((0.26, 0.28, 0.32)),
        "scrollbar_grab_hovered": over((0.32, 0.35, 0.40)), "scrollbar_grab_active": over(ACCENT),
        "check_mark": over(ACCENT),
        "slider_grab": over((0.52, 0.58, 0.68), 0.55), "slider_grab_active": over(ACCENT, 0.8),
        "button": over(_RAISED), "button_hovered": over((0.27, 0.30, 0.35)), "button_active": over(ACCENT, 0.75),
        "header": over((0.153, 0.169, 0.196)), "header_hovered": over(_RAISED), "header_active": over(ACCENT, 0.45),
        "separator": over((0.18, 0.195, 0.225)),
        "separator_hovered": over(ACCENT, 0.6), "separator_active": over(ACCENT),
        "resize_grip": over(PANEL, 0), "resize_grip_hovered": over(ACCENT, 0.5), "resize_grip_active": over(ACCENT),
        "tab": over(_BASE), "tab_hovered": over(_RAISED), "tab_selected": over(PANEL),
        "tab_selected_overline": over(ACCENT), "tab_dimmed": over(_BASE), "tab_dimmed_selected": over(PANEL),
        "tab_dimmed_selected_overline": over(ACCENT, 0.5), "docking_preview": over(ACCENT, 0.4),
        "docking_empty_bg": over(_BASE), "text_selected_bg": over(ACCENT, 0.35), "nav_cursor": over(ACCENT, 0.8),
        "modal_window_dim_bg": (0.02, 0.02, 0.03, 0.55),
    }  # fmt: skip


def window_background(alpha: float) -> None:
    """How opaque windows are from here on: what is drawn twice over all of the screen takes 5 ms in software."""
    imgui.get_style().set_color_(imgui.Col_.window_bg, vec4(PANEL, alpha))


def colour(rgb: Rgb, alpha: float = 1.0) -> int:
    """Packed colour for draw lists."""
    return imgui.get_color_u32(imgui.ImVec4(*rgb, alpha))


def vec4(rgb: Rgb, alpha: float = 1.0) -> imgui.ImVec4:
    """The same for style and text calls."""
    return imgui.ImVec4(*rgb, alpha)
