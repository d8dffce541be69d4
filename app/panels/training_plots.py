"""Curves and samples of the runs that are compared: losses, quality on held-out pictures, schedule and speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.curves import Chart, Curves, Line
from avatarrex_studio.panels.samples import Samples
from imgui_bundle import imgui, imgui_ctx

from avatarrex.training.runs.events import Series

Colours = dict[Path, theme.Rgb]
"""Of each run."""
QUALITY = {
    "heldout/psnr": Chart("PSNR, held out (dB)", "%.2f"),
    "heldout/ssim": Chart("SSIM, held out", "%.4f"),
    "heldout/lpips": Chart("LPIPS, held out", "%.4f"),
    "heldout/iou": Chart("IoU, held out", "%.4f"),
}
PROGRESS = {
    "schedule/lr": Chart("Learning rate", "%.3g", log=True),
    "schedule/gamma": Chart("γ", "%.4g", log=True),
    "rate/steps_per_s": Chart("Steps a second", "%.3g", smooth=True),
    "rate/samples_per_ray": Chart("Samples per ray", "%.3g", smooth=True),
    "memory/mib": Chart("Memory (MiB)", "%.0f"),
}
"""By tag below a part; shown where a run reports them."""


class TrainingPlots:
    """Everything beside the list of runs."""

    def __init__(self, colours: Colours, watcher: Watcher) -> None:
        self.colours, self.watcher = colours, watcher
        self.curves, self.samples = Curves(), Samples()
        self.part = ""
        self.term = "total"

    def draw(self, chosen: RunView, ticked: Sequence[RunView]) -> None:
        """Draw what `ticked` runs report; the parts of `chosen` are first."""
        parts = sorted({part for view in [chosen, *ticked] for part in view.parts}) or [chosen.part]
        shown = self.part if self.part in parts else chosen.part if chosen.part in parts else parts[0]
        if len(parts) > 1:
            shown = self._part_choice(parts, shown)
        drawn = ticked or [chosen]
        self.curves.options()
        width = widgets.room()
        losses = {view.path: view.tags("loss", shown) for view in drawn}
        lines = self._loss_lines(drawn, losses, width)
        if any(len(line.series.steps) for line in lines):
            title = "Loss" if len(drawn) == 1 else f"Loss: {self.term}"
            self.curves.plot(Chart(title, "%.3g", log=True, named=True, smooth=True), lines, (width, 240))
        else:
            widgets.caption("No losses reported yet")
        self._metrics(QUALITY, drawn, shown)
        if widgets.group("Samples", "training.samples")[0]:
            pairs = [(view, self.colours[view.path]) for view in drawn]
            self.samples.draw(pairs, self.watcher, shown)
        if widgets.group("Schedule and speed", "training.progress")[0]:
            self._metrics(PROGRESS, drawn, shown)

    def _part_choice(self, parts: Sequence[str], shown: str) -> str:
        for part in widgets.in_rows(parts, 4):
            colour = theme.vec4(theme.ACCENT, 0.45 if part == shown else 0.0)
            with imgui_ctx.push_style_color(imgui.Col_.button, colour):
                if imgui.button(f"{part.capitalize()}##curves", (84, 0)):
                    self.part = shown = part
        return shown

    def _loss_lines(self, drawn: Sequence[RunView], losses: dict[Path, dict[str, Series]], width: float) -> list[Line]:
        """All terms of a lone run, or one term of several."""
        names = sorted({name for terms in losses.values() for name in terms}, key=lambda name: (name != "total", name))
        if len(drawn) == 1:
            terms = losses[drawn[0].path]
            return [Line(name, theme.CURVES[k % len(theme.CURVES)], terms[name]) for k, name in enumerate(names)]
        if not names:
            return []
        if self.term not in names:
            self.term = names[0]
        if width > 460:
            imgui.same_line(0, 14)
        imgui.set_next_item_width(130)
        self.term = widgets.choice("##term", names, self.term, self.term) or self.term
        return self._lines(drawn, {path: terms.get(self.term) for path, terms in losses.items()})

    def _lines(self, drawn: Sequence[RunView], series: Mapping[Path, Series | None]) -> list[Line]:
        """One line for each run that reports it."""
        found = ((view, series[view.path]) for view in drawn)
        return [Line(view.name, self.colours[view.path], values) for view, values in found if values is not None]

    def _metrics(self, charts: Mapping[str, Chart], drawn: Sequence[RunView], part: str) -> None:
        reported = [
            (chart, lines) for tag, chart in charts.items()
            if (lines := self._lines(drawn, {view.path: view.series.get(f"{part}/{tag}") for view in drawn}))
        ]  # fmt: skip
        gap = imgui.get_style().item_spacing.x + 6
        columns, side = widgets.columns(170, gap, min(len(reported), 4))
        for chart, lines in widgets.in_rows(reported, gap, columns):
            self.curves.plot(chart, lines, (side, 150))
