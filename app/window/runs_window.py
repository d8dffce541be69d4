"""The window of `avatarrex-studio runs`: the Training panel alone, live while other processes train."""

from __future__ import annotations

import logging
from pathlib import Path

import moderngl
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.training import TrainingPanel
from avatarrex_studio.window.extent import USUAL, first_size
from avatarrex_studio.window.interface_scale import InterfaceScale
from avatarrex_studio.window.runner import runner_params
from avatarrex_studio.window.starting import check_display
from imgui_bundle import hello_imgui, imgui, imgui_ctx, immapp

from avatarrex.errors import InputError

log = logging.getLogger(__name__)
OPENGL = 330


class RunsWindow:
    """The loop's callbacks."""

    def __init__(self, folder: str | Path) -> None:
        self.panel = TrainingPanel(Watcher(folder), viewport=False)
        self._context: moderngl.Context | None = None
        self._scale = InterfaceScale()

    def params(self, size: tuple[int, int] = USUAL, remember: bool = True) -> hello_imgui.RunnerParams:
        """What the toolkit needs to run this window; `remember` keeps its place between runs."""
        title = f"Runs – {self.panel.watcher.folder} – AvatarReX Studio"
        params = runner_params(title, "avatarrex-runs.ini", size, remember)
        inner = params.imgui_window_params
        inner.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.provide_full_screen_window
        inner.show_menu_bar = inner.show_status_bar = False
        calls = params.callbacks
        calls.post_init, calls.post_new_frame = self._scale.open, self._scale.apply
        calls.pre_new_frame = self._upload
        calls.show_gui = self._draw
        calls.before_exit = self.panel.close
        return params

    def _draw(self) -> None:
        imgui.set_cursor_pos(imgui.ImVec2(14, 12))
        with imgui_ctx.begin_child("##runs", imgui.ImVec2(widgets.room() - 8, 0)):
            list(self.panel.draw())  # no viewport: no command comes back

    def _upload(self) -> None:
        if self._context is None:
            self._context = moderngl.create_context(require=OPENGL)
        self.panel.upload(self._context)
        self._context.screen.use()


def run_window(folder: str | Path) -> int:
    """Open the window on the runs below `folder`; returns the exit code. Raises `InputError`."""
    if not Path(folder).is_dir():
        raise InputError(folder, "", "a folder of runs", "nothing there" if not Path(folder).exists() else "a file")
    check_display(f"avatarrex-studio runs {folder} --text")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    immapp.run(RunsWindow(folder).params(first_size()))
    return 0
