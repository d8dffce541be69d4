"""Curves and samples of the runs that are compared: losses, quality on held-out pictures, schedule and speed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.curves import COLOURS, Curves, Line
from avatarrex_studio.panels.samples import Samples
from imgui_bundle import imgui

Colours = dict[Path, tuple[float, float, float]]
"""Of each run."""
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


class TrainingPlots:
    """Everything beside the list of runs."""

    def __init__(self, colours: Colours, watcher: Watcher) -> None:
        self.colours, self.watcher = colours, watcher
        self.curves, self.samples = Curves(), Samples()
        self.part = ""
        self.term = "total"

    def draw(self, chosen: RunView, ticked: Sequence[RunView]) -> None:
        """Draw what `ticked` runs report; `chosen` says whose parts come first."""
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
            pairs = [(view, self.colours[view.path]) for view in drawn]
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
        return [Line(view.name, self.colours[view.path], losses[view.path][self.term]) for view in drawn
                if self.term in losses[view.path]]  # fmt: skip

    def _metrics(
        self, metrics: Sequence[tuple[str, str, str, bool]], drawn: Sequence[RunView], part: str, width: float
    ) -> None:
        reported = [entry for entry in metrics if any(f"{part}/{entry[0]}" in view.series for view in drawn)]
        gap = imgui.get_style().item_spacing.x + 6
        columns = max(1, min(len(reported), 4, int((width + gap) / (170 + gap))))
        side = (width - gap * (columns - 1)) / columns
        for number, (tag, title, form, log_axis) in enumerate(reported):
            lines = [Line(view.name, self.colours[view.path], view.series[f"{part}/{tag}"]) for view in drawn
                     if f"{part}/{tag}" in view.series]  # fmt: skip
            if number % columns:
                imgui.same_line(0, gap)
            self.curves.plot(title, lines, (side, 150), log_axis, form, smooth=tag.startswith("rate/"))
