"""The Training panel: start, pause and stop runs, compare their curves, see their samples. The studio's tab and the
window of `avatarrex-studio runs` are this panel; it reads what a `Watcher` has published and waits for no file.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence

import moderngl
from avatarrex_studio.jobs.run_view import RunView, duration, keep_avatar
from avatarrex_studio.jobs.training_process import PARTS, TrainingProcesses
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import curves, theme, widgets
from avatarrex_studio.panels.run_list import RunList
from avatarrex_studio.panels.training_form import Order, TrainingForm
from avatarrex_studio.panels.training_plots import TrainingPlots
from avatarrex_studio.session.commands import Command, OpenAvatar
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.errors import InputError

log = logging.getLogger(__name__)
WIDE = 860.0
"""Points from which on the list stands beside the curves."""
LIST_WIDTH = 330.0


class TrainingPanel:
    """Runs below a folder. `viewport`: whether there is one that an avatar can be loaded into."""

    def __init__(self, watcher: Watcher, processes: TrainingProcesses | None = None, viewport: bool = True) -> None:
        self.watcher, self.viewport = watcher, viewport
        self.processes = processes or TrainingProcesses()
        self.form, self.runs = TrainingForm(), RunList()
        self.plots = TrainingPlots(self.runs.colours, watcher)
        self._error = ""

    def draw(self) -> list[Command]:
        """Draw the panel; an avatar to show comes back as a command."""
        if not self.watcher.ident:
            self.watcher.start()
        self.processes.poll()
        views = self.watcher.views
        chosen = self.runs.follow(views)
        if imgui.get_content_region_avail().x < WIDE:
            commands = self._side(views, chosen)
            imgui.spacing()
            self._plots(views, chosen)
            return commands
        imgui.begin_child("##list", imgui.ImVec2(LIST_WIDTH, 0))
        commands = self._side(views, chosen)
        imgui.end_child()
        imgui.same_line(0, 18)
        imgui.begin_child("##plots", imgui.ImVec2(0, 0))
        self._plots(views, chosen)
        imgui.end_child()
        return commands

    def upload(self, context: moderngl.Context) -> None:
        """Bring pictures into textures, before the interface's frame."""
        self.plots.samples.upload(context)

    def close(self) -> None:
        """End the reading; trainings go on."""
        self.watcher.close()
        self.plots.samples.close()
        curves.close()

    def _side(self, views: Sequence[RunView], chosen: RunView | None) -> list[Command]:
        """Start, list and details."""
        commands: list[Command] = []
        if self.viewport and widgets.group("New training", "training.new", False, opened=not views)[0]:
            order = self.form.draw(self.watcher.folder)
            if order is not None:
                self._start(order)
        if widgets.group(f"Runs  ({len(views)})", "training.runs", False)[0]:
            self.runs.draw(views)
            if not views:
                imgui.text_colored(theme.vec4(theme.MUTED), f"No runs below {self.watcher.folder}")
        if chosen is not None:
            commands += self._details(chosen)
        message = self._error or self.processes.message
        if message:
            imgui.spacing()
            _wrapped(message, theme.ERROR if self._error else theme.MUTED)
        self.form.files.draw()
        return commands

    def _plots(self, views: Sequence[RunView], chosen: RunView | None) -> None:
        if chosen is not None:
            self.plots.draw(chosen, self.runs.ticked(views))

    def _details(self, view: RunView) -> list[Command]:
        """Buttons and facts of the chosen run."""
        commands: list[Command] = []
        if not widgets.group(f"{view.name}", "training.details", False)[0]:
            return commands
        pressed = widgets.button_grid(self._buttons(view), 92)
        if pressed:
            self._error = ""
        try:
            if pressed == "pause":
                self.processes.pause(view.path)
            elif pressed == "resume":
                self.processes.go_on(view.path)
            elif pressed == "stop":
                self.processes.stop(view.path)
            elif pressed == "continue":
                config = view.about["config"]
                parts = config.get("parts") or ([view.about["part"]] if view.about.get("part") else PARTS)
                preset, capture = str(view.about.get("preset")), str(view.about.get("capture") or "")
                self._start(Order(capture, preset, view.path, list(parts)), resume=True)
            elif pressed == "load":
                commands.append(OpenAvatar(str(keep_avatar(view))))
            if pressed:
                self.watcher.look_again()
        except InputError as error:
            self._error = str(error)
            log.error("%s", error)
        if imgui.begin_table("facts", 2, imgui.TableFlags_.sizing_stretch_prop):
            for name, value in facts(view):
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text_colored(theme.vec4(theme.MUTED), name)
                imgui.table_next_column()
                imgui.text_wrapped(value)
            imgui.end_table()
        if view.note:
            _wrapped(view.note, theme.ERROR)
        return commands

    def _buttons(self, view: RunView) -> list[tuple[str, str]]:
        buttons = []
        if view.state == "running":
            buttons.append(("pause", f"{icons.ICON_FA_PAUSE}  Pause"))
        if view.state == "paused":
            buttons.append(("resume", f"{icons.ICON_FA_PLAY}  Resume"))
        if view.live:
            buttons.append(("stop", f"{icons.ICON_FA_STOP}  Stop"))
        elif self.viewport and view.state != "finished" and not self.processes.working(view.path):
            buttons.append(("continue", f"{icons.ICON_FA_PLAY}  Continue"))
        if self.viewport and view.avatar:
            buttons.append(("load", f"{icons.ICON_FA_PERSON}  Show avatar"))
        return buttons

    def _start(self, order: Order, resume: bool = False) -> None:
        try:
            self.processes.start(*order, resume)
            self._error, self.runs.chosen = "", order.out
        except InputError as error:
            self._error = str(error)
            log.error("%s", error)


def facts(view: RunView) -> list[tuple[str, str]]:
    """What there is to say about a run, by name."""
    about = view.about
    started = about.get("started")
    rows = [
        ("Capture", str(about.get("capture") or "")),
        ("Preset", f"{about.get('preset') or ''}   seed {about.get('seed')}" if about.get("preset") else ""),
        ("Started", time.strftime("%d %b %H:%M", time.localtime(started)) if isinstance(started, int | float) else ""),
        ("Resumed", f"{len(about.get('resumed') or [])} times" if about.get("resumed") else ""),
        ("Rate", f"{view.rate:.3g} steps a second" if view.rate else ""),
        ("Time left", duration(view.eta) if view.eta is not None else ""),
        ("Checkpoint", view.checkpoints[-1].name.removeprefix("step_").lstrip("0") or "0" if view.checkpoints else ""),
    ]
    return [(name, value) for name, value in rows if value]


def _wrapped(text: str, colour: tuple[float, float, float]) -> None:
    imgui.push_style_color(imgui.Col_.text, theme.vec4(colour))
    imgui.text_wrapped(text)
    imgui.pop_style_color()
