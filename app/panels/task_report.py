"""A task of the Training tab: how far it is while it is at work, then what it printed and its pictures."""

from __future__ import annotations

from pathlib import Path

import moderngl
import numpy as np
from avatarrex_studio.jobs.task import Outcome, Progress, Tasks
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.texture import uploaded
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

TEXT_HEIGHT = 190.0


class TaskReport:
    """The report and the picture of it that is looked at."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self._picture: Path | None = None
        self._wanted: tuple[object, np.ndarray] | None = None
        self._texture: tuple[object, moderngl.Texture] | None = None

    def draw_running(self, tasks: Tasks) -> None:
        """A line with *Cancel* while one is at work."""
        if tasks.task is None:
            return
        widgets.caption(f"{icons.ICON_FA_HOURGLASS_HALF}  {tasks.task.title}", theme.TEXT)
        imgui.same_line(max(widgets.room() - 70, 120))
        if imgui.small_button("Cancel##task"):
            tasks.cancel()
        if progress := Progress.read(tasks.line):
            imgui.progress_bar(progress.share, imgui.ImVec2(-1, 0), progress.words)
        else:
            widgets.paragraph(tasks.line or "Starting…")

    def draw(self, outcome: Outcome) -> bool:
        """What came out of the last one; whether it was closed."""
        widgets.caption(outcome.task.title, theme.TEXT if outcome.done else theme.ERROR)
        imgui.same_line(max(widgets.room() - 60, 120))
        closed = imgui.small_button("Close##report")
        with imgui_ctx.begin_child("##report.text", imgui.ImVec2(0, TEXT_HEIGHT), imgui.ChildFlags_.borders):
            for line in outcome.text.splitlines():
                imgui.text_unformatted(line)
        pictures = [path for path in outcome.task.pictures if outcome.done and path.is_file()]
        self._wanted = None
        if len(pictures) > 1:
            for path in widgets.in_rows(pictures, 4):
                if imgui.radio_button(f"{path.stem}##report", path == self._shown(pictures)):
                    self._picture = path
        if pictures:
            self._draw_picture(self._shown(pictures))
        return closed

    def upload(self, context: moderngl.Context) -> None:
        """Bring the picture that was drawn into a texture. Before the interface's frame, in the window's context."""
        if self._wanted and (self._texture is None or self._texture[0] != self._wanted[0]):
            version, pixels = self._wanted
            self._texture = version, uploaded(context, pixels, self._texture[1] if self._texture else None)

    def close(self) -> None:
        """Give the texture back."""
        if self._texture:
            self._texture[1].release()
            self._texture = None

    def _shown(self, pictures: list[Path]) -> Path:
        return self._picture if self._picture in pictures and self._picture else pictures[0]

    def _draw_picture(self, path: Path) -> None:
        """As wide as there is room."""
        pixels = self._watcher.picture(path)
        if pixels is not None:
            self._wanted = (path, path.stat().st_mtime_ns), pixels
        if self._texture is None or pixels is None or self._texture[0] != self._wanted[0]:  # type: ignore[index]
            widgets.caption("Reading the picture…")
            return
        height, width = pixels.shape[:2]
        side = min(widgets.room(), float(width))
        imgui.image(imgui.ImTextureRef(self._texture[1].glo), (side, side * height / width))
