"""The Training panel: start, pause and stop runs, compare their curves, see their samples. The studio's tab and the
window of `avatarrex-studio runs` are this panel; it reads what a `Watcher` has published and waits for no file.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import moderngl
from avatarrex_studio.jobs.evaluations import Evaluations, evaluating
from avatarrex_studio.jobs.run_view import RunView, duration, keep_avatar
from avatarrex_studio.jobs.task import Task, Tasks
from avatarrex_studio.jobs.training_process import Order, TrainingProcesses
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import curves, evaluation_table, theme, widgets
from avatarrex_studio.panels.capture_tools import CaptureTools
from avatarrex_studio.panels.run_list import RunList
from avatarrex_studio.panels.task_report import TaskReport
from avatarrex_studio.panels.training_form import TrainingForm
from avatarrex_studio.panels.training_plots import TrainingPlots
from avatarrex_studio.session.commands import Command, OpenAvatar
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

from avatarrex.errors import InputError
from avatarrex.training.recipe import TRAINED
from avatarrex.training.runs.control import request

log = logging.getLogger(__name__)
WIDE = 860.0
"""Points from which on the list is beside the curves."""
LIST_WIDTH = 330.0


class TrainingPanel:
    """Runs below a folder. `viewport`: whether there is one that an avatar can be loaded into."""

    def __init__(
        self,
        watcher: Watcher,
        processes: TrainingProcesses | None = None,
        viewport: bool = True,
        tasks: Tasks | None = None,
    ) -> None:
        self.watcher, self.viewport = watcher, viewport
        self.processes = processes or TrainingProcesses()
        self.form, self.runs = TrainingForm(), RunList()
        self.plots = TrainingPlots(self.runs.colours, watcher)
        self.tasks, self.tools, self.report = tasks or Tasks(), CaptureTools(self.form.files), TaskReport(watcher)
        self.evaluations, self.baselines = Evaluations(), False
        self._error = ""
        self._unfold = False

    def draw(self) -> Iterator[Command]:
        """Draw the panel; an avatar to show is returned as a command."""
        if not self.watcher.ident:
            self.watcher.start()
        self.processes.poll()
        ended = self.tasks.poll()
        if ended and ended.done and ended.task.capture:
            self.form.take(ended.task.capture)
        views = self.watcher.views
        chosen = self.runs.follow(views)
        if widgets.room() < WIDE:
            yield from self._side(views, chosen)
            imgui.spacing()
            self._plots(views, chosen)
            return
        with imgui_ctx.begin_child("##list", imgui.ImVec2(LIST_WIDTH, 0)):
            yield from self._side(views, chosen)
        imgui.same_line(0, 18)
        with imgui_ctx.begin_child("##plots", imgui.ImVec2(0, 0)):
            self._plots(views, chosen)

    @property
    def at_work(self) -> bool:
        """Whether a training or a task goes on."""
        return self.tasks.task is not None or any(view.live for view in self.watcher.views)

    def upload(self, context: moderngl.Context) -> None:
        """Bring pictures into textures, before the interface's frame."""
        self.plots.samples.upload(context)
        self.report.upload(context)

    def close(self) -> None:
        """End the reading and what is checked, made or evaluated; trainings go on."""
        self.tasks.close()
        self.report.close()
        self.watcher.close()
        self.plots.samples.close()
        curves.close()

    def fill_in(self, capture: str, words: str) -> None:
        """A capture for the next training, and what there is to say about it."""
        self.form.take(capture, words)
        self._unfold = True

    def import_capture(self) -> None:
        """Show what an import needs, and ask for its source."""
        self.tools.shown, self._unfold = "import", True
        self.tools.imported.choose()

    def choose(self, run: Path) -> None:
        """Show a run; one that lies elsewhere is watched, too."""
        self.runs.chosen = self.watcher.include(run)
        self.watcher.look_again()

    def _side(self, views: Sequence[RunView], chosen: RunView | None) -> Iterator[Command]:
        """Start, list and details."""
        if self._unfold:
            imgui.set_next_item_open(True)
            self._unfold = False
        if self.viewport and widgets.group("New training", "training.new", opened=not views)[0]:
            order = self.form.draw(self.watcher.folder, lambda: self._do(self.tools.draw(self.form.capture)))
            if order is not None:
                self._start(order)
        if widgets.group(f"Runs  ({len(views)})", "training.runs")[0]:
            self.runs.draw(views)
            if not views:
                widgets.caption(f"No runs below {self.watcher.folder}")
        if chosen is not None and widgets.group(chosen.name, "training.details")[0]:
            yield from self._details(chosen)
        self.report.draw_running(self.tasks)
        message = self._error or self.processes.message
        if message:
            imgui.spacing()
            widgets.paragraph(message, theme.ERROR if self._error else theme.MUTED)
        self.form.files.draw()

    def _plots(self, views: Sequence[RunView], chosen: RunView | None) -> None:
        """What was found last, the comparison of what was evaluated, and curves."""
        if self.tasks.outcome is not None and self.report.draw(self.tasks.outcome):
            self.tasks.outcome = None
        rows = [
            row for view in self.runs.ticked(views) or ([chosen] if chosen else []) for row in self.evaluations.of(view)
        ]
        if rows and widgets.group("Evaluated on what was kept from training", "training.evaluated")[0]:
            evaluation_table.draw(rows)
        if chosen is not None:
            self.plots.draw(chosen, self.runs.ticked(views))

    def _details(self, view: RunView) -> Iterator[Command]:
        """Buttons and facts of the chosen run."""
        if pressed := widgets.button_grid(self._buttons(view), 92):
            self._error = ""
            with self._errors_shown():
                yield from self._press(pressed, view)
                self.watcher.look_again()
        if self._evaluable(view):
            _, self.baselines = imgui.checkbox("Evaluate with baselines##evaluate", self.baselines)
            widgets.tooltip(
                "Beside it the template: naked, textured and in one colour, and with its skin fitted: some minutes more"
            )
        rows = (((widgets.caption, k, theme.MUTED), (widgets.paragraph, v, theme.TEXT)) for k, v in facts(view).items())
        widgets.table("facts", imgui.TableFlags_.sizing_stretch_prop, rows)
        if view.note:
            widgets.paragraph(view.note, theme.ERROR)

    def _buttons(self, view: RunView) -> dict[str, str]:
        """Titles by name, of what can be done with a run as it is."""
        ended = self.viewport and not view.live and view.state != "finished" and not self.processes.working(view.path)
        buttons = {
            "pause": (view.state == "running", f"{icons.ICON_FA_PAUSE}  Pause"),
            "resume": (view.state == "paused", f"{icons.ICON_FA_PLAY}  Resume"),
            "stop": (view.live, f"{icons.ICON_FA_STOP}  Stop"),
            "continue": (ended, f"{icons.ICON_FA_PLAY}  Continue"),
            "evaluate": (self._evaluable(view), f"{icons.ICON_FA_RULER_COMBINED}  Evaluate"),
            "load": (self.viewport and view.avatar is not None, f"{icons.ICON_FA_PERSON}  Show avatar"),
        }
        return {name: title for name, (possible, title) in buttons.items() if possible}

    def _press(self, button: str, view: RunView) -> Iterator[Command]:
        """Do what one of `_buttons` says. Raises `InputError`."""
        if button == "evaluate":
            self._do(evaluating(view, keep_avatar(view), self.baselines))
        elif button == "load":
            yield OpenAvatar(str(keep_avatar(view)))
        elif button == "continue":
            about = view.about
            parts = about["config"].get("parts") or ([about["part"]] if about.get("part") else TRAINED)
            order = Order(str(about.get("capture") or ""), str(about.get("preset")), view.path, list(parts))
            self._start(order, resume=True)
        elif button == "stop":
            self.processes.stop(view.path)
        else:
            request(view.path, "pause" if button == "pause" else "run")

    def _evaluable(self, view: RunView) -> bool:
        """Whether the newest avatar of a run can be compared with its capture."""
        return self.viewport and view.avatar is not None and bool(view.about.get("capture")) and self.tasks.task is None

    def _do(self, task: Task | None) -> None:
        if task is not None:
            with self._errors_shown():
                self.tasks.start(task)
                self._error = ""

    def _start(self, order: Order, resume: bool = False) -> None:
        with self._errors_shown():
            self.processes.start(order, resume)
            self._error, self.runs.chosen = "", order.out

    @contextmanager
    def _errors_shown(self) -> Iterator[None]:
        """A refusal is shown in the panel and in the console."""
        try:
            yield
        except InputError as error:
            self._error = str(error)
            log.error("%s", error)


def facts(view: RunView) -> dict[str, str]:
    """What there is to say about a run, by name."""
    about = view.about
    started, resumed, preset = (about.get(name) for name in ("started", "resumed", "preset"))
    rows = {
        "Capture": str(about.get("capture") or ""),
        "Recipe": f"{preset}   seed {about.get('seed')}" if preset else "",
        "Started": time.strftime("%d %b %H:%M", time.localtime(started)) if isinstance(started, int | float) else "",
        "Resumed": f"{len(resumed)} times" if resumed else "",
        "Rate": f"{view.rate:.3g} steps a second" if view.rate else "",
        "Time left": duration(view.eta) if view.eta is not None else "",
        "Checkpoint": view.checkpoints[-1].name.removeprefix("step_").lstrip("0") or "0" if view.checkpoints else "",
    }
    return {name: value for name, value in rows.items() if value}
