"""The Training panel: start, pause and stop runs, compare their curves, see their samples. The studio's tab and the
window of `avatarrex-studio runs` are this panel; it reads what a `Watcher` has published and waits for no file.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path

import moderngl
from avatarrex_studio.commands import Command, OpenAvatar
from avatarrex_studio.panels import curves, theme, widgets
from avatarrex_studio.panels.curves import COLOURS, Curves, Line
from avatarrex_studio.panels.files import FileDialogs
from avatarrex_studio.panels.samples import Samples
from avatarrex_studio.run_view import RunView, keep_avatar
from avatarrex_studio.runs_text import duration
from avatarrex_studio.training_process import PARTS, PRESETS, TrainingProcesses
from avatarrex_studio.watcher import Watcher
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.errors import InputError

log = logging.getLogger(__name__)
WIDE = 860.0
"""Points from which on the list stands beside the curves."""
LIST_WIDTH = 330.0
STATE_COLOURS = {
    "running": (0.47, 0.79, 0.50), "paused": theme.WARNING, "finished": theme.ACCENT, "stopped": theme.MUTED,
    "failed": theme.ERROR, "dead": theme.ERROR,
}  # fmt: skip
QUALITY = (
    ("heldout/psnr", "PSNR, held out (dB)", "%.2f", False), ("heldout/ssim", "SSIM, held out", "%.4f", False),
    ("heldout/lpips", "LPIPS, held out", "%.4f", False), ("heldout/iou", "IoU, held out", "%.4f", False),
)  # fmt: skip
PROGRESS = (
    ("schedule/lr", "Learning rate", "%.3g", True), ("schedule/gamma", "γ", "%.4g", True),
    ("rate/steps_per_s", "Steps a second", "%.3g", False), ("rate/samples_per_ray", "Samples per ray", "%.3g", False),
    ("memory/mib", "Memory (MiB)", "%.0f", False),
)  # fmt: skip
"""Tags below a part with title, format and whether the axis is logarithmic; shown where a run reports them."""


class TrainingPanel:
    """Runs below a folder. `viewport`: whether there is one that an avatar can be loaded into."""

    def __init__(self, watcher: Watcher, processes: TrainingProcesses | None = None, viewport: bool = True) -> None:
        self.watcher, self.viewport = watcher, viewport
        self.processes = processes or TrainingProcesses()
        self.curves, self.samples, self.files = Curves(), Samples(), FileDialogs()
        self.capture, self.preset, self.out, self.parts = "", PRESETS[0], "", list(PARTS)
        self.chosen: Path | None = None
        """The run whose details, buttons and terms are shown."""
        self.part = ""
        self.term = "total"
        self._hidden: set[Path] = set()
        self._colours: dict[Path, tuple[float, float, float]] = {}
        self._error = ""

    def draw(self) -> list[Command]:
        """Draw the panel; an avatar to show comes back as a command."""
        if not self.watcher.ident:
            self.watcher.start()
        self.processes.poll()
        views = self.watcher.views
        for view in views:
            self._colours.setdefault(view.path, COLOURS[len(self._colours) % len(COLOURS)])
        chosen = next((view for view in views if view.path == self.chosen), None)
        if chosen is None and views:
            chosen = max(views, key=lambda view: (view.live, view.about.get("started") or 0))
            self.chosen = chosen.path
        ticked = [view for view in views if view.path not in self._hidden]
        if imgui.get_content_region_avail().x < WIDE:
            return self._narrow(views, chosen, ticked)
        imgui.begin_child("##list", imgui.ImVec2(LIST_WIDTH, 0))
        commands = self._side(views, chosen)
        imgui.end_child()
        imgui.same_line(0, 18)
        imgui.begin_child("##plots", imgui.ImVec2(0, 0))
        self._plots(chosen, ticked)
        imgui.end_child()
        return commands

    def upload(self, context: moderngl.Context) -> None:
        """Bring pictures into textures, before the interface's frame."""
        self.samples.upload(context)

    def close(self) -> None:
        """End the reading; trainings go on."""
        self.watcher.close()
        self.samples.close()
        curves.close()

    def _narrow(self, views: Sequence[RunView], chosen: RunView | None, ticked: Sequence[RunView]) -> list[Command]:
        commands = self._side(views, chosen)
        imgui.spacing()
        self._plots(chosen, ticked)
        return commands

    def _side(self, views: Sequence[RunView], chosen: RunView | None) -> list[Command]:
        """Start, list and details."""
        commands: list[Command] = []
        if self.viewport and widgets.group("New training", "training.new", False, opened=not views)[0]:
            self._start_form()
        if widgets.group(f"Runs  ({len(views)})", "training.runs", False)[0]:
            for view in views:
                self._entry(view)
            if not views:
                imgui.text_colored(theme.vec4(theme.MUTED), f"No runs below {self.watcher.folder}")
        if chosen is not None:
            commands += self._details(chosen)
        message = self._error or self.processes.message
        if message:
            imgui.spacing()
            imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.ERROR if self._error else theme.MUTED))
            imgui.text_wrapped(message)
            imgui.pop_style_color()
        self.files.draw()
        return commands

    def _start_form(self) -> None:
        label = 72.0
        widgets.label("Capture", False, label)
        imgui.set_next_item_width(imgui.get_content_region_avail().x - 36)
        _, self.capture = imgui.input_text_with_hint("##capture", "Folder or .zip", self.capture)
        imgui.same_line(0, 4)
        if imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}##capture", imgui.ImVec2(32, 0)):
            self.files.open("capture", "Open a capture: its zip, or a file in its folder", self._took_capture)
        widgets.label("Preset", False, label)
        imgui.set_next_item_width(imgui.get_content_region_avail().x)
        if imgui.begin_combo("##preset", self.preset.capitalize()):
            for name in PRESETS:
                if imgui.selectable(name.capitalize(), name == self.preset)[0]:
                    self.preset = name
            imgui.end_combo()
        widgets.label("Parts", False, label)
        for number, name in enumerate(PARTS):
            if number:
                imgui.same_line(0, 14)
            toggled, on = imgui.checkbox(f"{name.capitalize()}##part", name in self.parts)
            if toggled:
                self.parts = [entry for entry in PARTS if (on if entry == name else entry in self.parts)]
        widgets.label("Into", False, label)
        imgui.set_next_item_width(imgui.get_content_region_avail().x)
        hint = str(self.watcher.folder / time.strftime("%Y-%m-%d"))
        _, self.out = imgui.input_text_with_hint("##out", hint, self.out)
        imgui.begin_disabled(not self.capture.strip() or not self.parts)
        if imgui.button(f"{icons.ICON_FA_PLAY}  Start training", imgui.ImVec2(imgui.get_content_region_avail().x, 0)):
            self._start(self.capture, self.preset, Path(self.out.strip() or _free(Path(hint))), self.parts)
        imgui.end_disabled()
        imgui.spacing()

    def _entry(self, view: RunView) -> None:
        """One run of the list: tick box, name, state, progress."""
        imgui.push_id(str(view.path))
        colour, state = self._colours[view.path], STATE_COLOURS.get(view.state, theme.MUTED)
        imgui.push_style_color(imgui.Col_.check_mark, theme.vec4(colour))
        toggled, _ = imgui.checkbox("##shown", view.path not in self._hidden)
        imgui.pop_style_color()
        if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
            imgui.set_tooltip("Draw its curves")
        if toggled:
            self._hidden ^= {view.path}
        imgui.same_line()
        start, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
        line = imgui.get_text_line_height()
        size = imgui.ImVec2(width, 2 * line + 16)
        if imgui.selectable("##choose", view.path == self.chosen, 0, size)[0]:
            self.chosen = view.path
        canvas, pad = imgui.get_window_draw_list(), 6.0

        def write(x: float, y: float, text: str, rgb: tuple[float, float, float]) -> None:
            canvas.add_text(imgui.ImVec2(start.x + x, start.y + y), theme.colour(rgb), text)

        end = imgui.calc_text_size(view.state).x
        dot = imgui.ImVec2(start.x + width - end - pad - 9, start.y + 2 + line / 2)
        canvas.push_clip_rect(start, imgui.ImVec2(dot.x - 8, start.y + size.y), True)
        write(pad, 2, view.name, theme.TEXT if view.path not in self._hidden else theme.MUTED)
        canvas.pop_clip_rect()
        canvas.add_circle_filled(dot, 3, theme.colour(state))
        write(width - end - pad, 2, view.state, state)
        canvas.push_clip_rect(start, imgui.ImVec2(start.x + width, start.y + size.y), True)
        write(pad, line + 5, _progress(view), theme.MUTED)
        canvas.pop_clip_rect()
        low = imgui.ImVec2(start.x + pad, start.y + size.y - 6)
        high = imgui.ImVec2(start.x + width - pad, low.y + 3)
        canvas.add_rect_filled(low, high, theme.colour(theme.TEXT, 0.08), 1.5)
        if view.progress:
            high = imgui.ImVec2(low.x + view.progress * (high.x - low.x), high.y)
            canvas.add_rect_filled(low, high, theme.colour(colour, 0.9), 1.5)
        imgui.pop_id()

    def _details(self, view: RunView) -> list[Command]:
        """Buttons and facts of the chosen run."""
        commands: list[Command] = []
        if not widgets.group(f"{view.name}", "training.details", False)[0]:
            return commands
        pressed = widgets.button_grid(self._buttons(view), 92)
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
                self._start(capture, preset, view.path, parts, resume=True)
            elif pressed == "load":
                commands.append(OpenAvatar(str(keep_avatar(view))))
            if pressed:
                self._error = ""
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
            imgui.push_style_color(imgui.Col_.text, theme.vec4(theme.ERROR))
            imgui.text_wrapped(view.note)
            imgui.pop_style_color()
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

    def _start(self, capture: str, preset: str, out: Path, parts: Sequence[str], resume: bool = False) -> None:
        try:
            self.processes.start(capture, preset, out, parts, resume)
            self._error, self.chosen = "", out
        except InputError as error:
            self._error = str(error)
            log.error("%s", error)

    def _took_capture(self, path: str) -> None:
        self.capture = path if path.endswith(".zip") or Path(path).is_dir() else str(Path(path).parent)

    def _plots(self, chosen: RunView | None, ticked: Sequence[RunView]) -> None:
        if chosen is None:
            return
        parts = sorted({part for view in [chosen, *ticked] for part in view.parts}) or [chosen.part]
        shown = self.part if self.part in parts else chosen.part if chosen.part in parts else parts[0]
        if len(parts) > 1:
            shown = self._part_choice(parts, shown)
        drawn = ticked or [chosen]
        self.curves.options()
        width = imgui.get_content_region_avail().x
        losses = {view.path: view.tags("loss", shown) for view in drawn}
        lines = self._loss_lines(drawn, losses, width)
        if any(len(line.series.steps) for line in lines):
            title = "Loss" if len(drawn) == 1 else f"Loss: {self.term}"
            self.curves.plot(title, lines, (width, 240), log=True, form="%.3g", named=True, smooth=True)
        else:
            imgui.text_colored(theme.vec4(theme.MUTED), "No losses reported yet")
        self._metrics(QUALITY, drawn, shown, width)
        if widgets.group("Samples", "training.samples", False)[0]:
            pairs = [(view, self._colours[view.path]) for view in drawn]
            self.samples.draw(pairs, self.watcher, shown)
        if widgets.group("Schedule and speed", "training.progress", False)[0]:
            self._metrics(PROGRESS, drawn, shown, width)

    def _part_choice(self, parts: Sequence[str], shown: str) -> str:
        for number, part in enumerate(parts):
            if number:
                imgui.same_line(0, 4)
            imgui.push_style_color(imgui.Col_.button, theme.vec4(theme.ACCENT, 0.45 if part == shown else 0.0))
            if imgui.button(f"{part.capitalize()}##curves", imgui.ImVec2(84, 0)):
                self.part = shown = part
            imgui.pop_style_color()
        return shown

    def _loss_lines(self, drawn: Sequence[RunView], losses: dict[Path, dict], width: float) -> list[Line]:
        """All terms of a lone run, or one term of several."""
        if len(drawn) == 1:
            terms = sorted(losses[drawn[0].path], key=lambda name: (name != "total", name))
            return [Line(term, COLOURS[k % len(COLOURS)], losses[drawn[0].path][term]) for k, term in enumerate(terms)]
        names = sorted({name for terms in losses.values() for name in terms}, key=lambda name: (name != "total", name))
        if not names:
            return []
        if self.term not in names:
            self.term = names[0]
        if width > 460:
            imgui.same_line(0, 14)
        imgui.set_next_item_width(130)
        if imgui.begin_combo("##term", self.term):
            for name in names:
                if imgui.selectable(name, name == self.term)[0]:
                    self.term = name
            imgui.end_combo()
        return [Line(view.name, self._colours[view.path], losses[view.path][self.term]) for view in drawn
                if self.term in losses[view.path]]  # fmt: skip

    def _metrics(self, metrics: Sequence[tuple[str, str, str, bool]], drawn: Sequence[RunView], part: str, width: float
                 ) -> None:  # fmt: skip
        reported = [entry for entry in metrics if any(f"{part}/{entry[0]}" in view.series for view in drawn)]
        gap = imgui.get_style().item_spacing.x + 6
        columns = max(1, min(len(reported), 4, int((width + gap) / (170 + gap))))
        side = (width - gap * (columns - 1)) / columns
        for number, (tag, title, form, log_axis) in enumerate(reported):
            lines = [Line(view.name, self._colours[view.path], view.series[f"{part}/{tag}"]) for view in drawn
                     if f"{part}/{tag}" in view.series]  # fmt: skip
            if number % columns:
                imgui.same_line(0, gap)
            self.curves.plot(title, lines, (side, 150), log_axis, form, smooth=tag.startswith("rate/"))


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


def _progress(view: RunView) -> str:
    """`Body I   1,240 / 4,000   24.3 dB   12 min left`."""
    psnr = view.last("heldout/psnr")
    words = [
        f"{view.part.capitalize()} {view.pass_name}".strip(),
        f"{view.step:,} / {view.steps:,}" if view.steps else f"step {view.step:,}",
        f"{psnr:.1f} dB" if psnr is not None else "",
        f"{duration(view.eta)} left" if view.eta is not None else "",
    ]
    return "   ".join(filter(None, words))


def _free(path: Path) -> Path:
    """`path`, or with a number behind it where it is taken."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate
