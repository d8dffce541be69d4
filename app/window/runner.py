"""What every window of the program sets of its toolkit."""

from __future__ import annotations

from avatarrex_studio.panels import theme
from imgui_bundle import hello_imgui


def runner_params(title: str, ini: str, size: tuple[int, int], remember: bool) -> hello_imgui.RunnerParams:
    """A window with the studio's fonts and colours; `remember` keeps its place between runs, in the user's file `ini`."""
    params = hello_imgui.RunnerParams()
    params.app_window_params.window_title = title
    params.app_window_params.window_geometry.size = size
    params.app_window_params.restore_previous_geometry = remember
    params.ini_disable = not remember
    params.ini_folder_type = hello_imgui.IniFolderType.app_user_config_folder
    params.ini_filename = ini
    params.imgui_window_params.remember_theme = False
    params.fps_idling.fps_idle = 4
    params.callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
    params.callbacks.load_additional_fonts = theme.load_fonts
    params.callbacks.setup_imgui_style = theme.apply_style
    return params
