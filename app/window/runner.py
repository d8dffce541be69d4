"""What every window of the program sets of its toolkit."""

from __future__ import annotations

from avatarrex_studio.panels import theme
from imgui_bundle import hello_imgui

LEAST = 330
"""OpenGL of a window that draws panels alone."""


def runner_params(title: str, ini: str, size: tuple[int, int], remember: bool) -> hello_imgui.RunnerParams:
    """A window with the studio's fonts and colours; `remember` keeps its place between runs, in the user's file `ini`."""
    params = hello_imgui.RunnerParams()
    params.app_window_params.window_title = title
    geometry = params.app_window_params.window_geometry
    geometry.size, geometry.window_size_measure_mode = size, hello_imgui.WindowSizeMeasureMode.screen_coords
    params.app_window_params.restore_previous_geometry = remember
    params.ini_disable = not remember
    params.ini_folder_type = hello_imgui.IniFolderType.app_user_config_folder
    params.ini_filename = ini
    params.imgui_window_params.remember_theme = False
    params.dpi_aware_params.dpi_window_size_factor = 1.0  # interface_scale.py does it
    params.fps_idling.fps_idle = 4
    params.renderer_backend_options.open_gl_options = open_gl(LEAST)
    params.callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
    params.callbacks.load_additional_fonts = theme.load_fonts
    params.callbacks.setup_imgui_style = theme.apply_style
    return params


def open_gl(version: int) -> hello_imgui.OpenGlOptions:
    """A core profile, one sample a pixel. Every window says so: GLFW keeps the samples of the window before, four of them take three
    times as long in software."""
    options = hello_imgui.OpenGlOptions()
    options.major_version, options.minor_version = divmod(version // 10, 10)
    options.use_core_profile = True
    options.anti_aliasing_samples = 0
    return options
