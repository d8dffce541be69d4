"""Run time against error as PNG: one Pareto plot per piece of work, and one of how cost grows."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from avatarrex.measure.bench.report import Metric
from avatarrex.measure.plotting import Axes, axes_beside, save

Entry = tuple[str, float, float, str]
"""Contestant, milliseconds, error, and its name in `ERRORS`."""
ERRORS = {
    "max_error_m": "largest error, m", "max_error": "largest difference", "mean_error_mm": "mean error, mm",
    "depth_mean_mm": "mean depth error, mm", "changed_crossings": "changed crossings",
}  # fmt: skip
"""The error that stands against the time, the first that a contest has."""
ERROR_FLOOR = 1e-10
"""An error of zero is drawn here."""
FEW_DECADES = 300
"""Ratio of an axis' ends up to which its ticks are plain numbers."""


def plot(metrics: list[Metric], folder: Path) -> list[Path]:
    """Write what the metrics allow. Raises `InputError` without matplotlib or where the folder cannot be written."""
    made = []
    for case, entries in pareto(metrics).items():
        axis, figure = axes_beside(1, (5.2, 4.0))
        _pareto(axis[0], case, entries)
        made.append(save(figure, folder / f"{case.replace('.', '_')}.png"))
    growth = [metric for metric in metrics if metric.name.startswith("growth.")]
    if growth:
        axes, figure = axes_beside(len(growth), (5.2 if len(growth) == 1 else 4.0 * len(growth), 4.0))
        for axis, metric in zip(axes, growth):
            _growth(axis, metric)
        made.append(save(figure, folder / "growth.png"))
    return made


def pareto(metrics: list[Metric]) -> dict[str, list[Entry]]:
    """Every case with at least two contestants."""
    found: dict[str, list[Entry]] = defaultdict(list)
    for metric in metrics:
        *case, contestant, unit = metric.name.rsplit(".", 2)
        error = metric.error or {}
        kind = next((key for key in ERRORS if key in error), None)
        if unit == "ms" and kind is not None:
            found["".join(case)].append((contestant, metric.value, float(error[kind]), kind))
    return {case: entries for case, entries in found.items() if len(entries) > 1}


def front(entries: list[Entry]) -> list[tuple[float, float]]:
    """(ms, error) of those that nobody beats in both, from the quickest on."""
    kept: list[tuple[float, float]] = []
    for _, ms, error, _ in sorted(entries, key=lambda entry: (entry[1], entry[2])):
        if not kept or error < kept[-1][1]:
            kept.append((ms, error))
    return kept


def _pareto(axis: Axes, case: str, entries: list[Entry]) -> None:
    best = front(entries)
    axis.step([ms for ms, _ in best], [max(error, ERROR_FLOOR) for _, error in best], where="post", color="0.7", lw=1)
    for name, ms, error, _ in entries:
        mine = name.startswith("ours") or not case.startswith(("sdf", "mlp", "raycast", "skinning"))
        axis.plot(ms, max(error, ERROR_FLOOR), "o", color="tab:blue" if mine else "0.4")
        axis.annotate(name, (ms, max(error, ERROR_FLOOR)), xytext=(5, 4), textcoords="offset points", fontsize=8)
    axis.set(xscale="log", yscale="log", xlabel="ms", ylabel=ERRORS[entries[0][3]])
    axis.set_title(case, fontsize=10)
    axis.margins(0.25)
    _ticks(axis)


def _growth(axis: Axes, metric: Metric) -> None:
    error = metric.error or {}
    size, ms = np.array(error["size"]), np.array(error["ms"])
    axis.plot(size, ms, "o", color="tab:blue")
    axis.plot(size, error["factor"] * size**metric.value, "-", color="0.7")
    axis.set(xscale="log", yscale="log", xlabel=error["of"], ylabel="ms")
    axis.set_title(f"{metric.name.split('.')[1]}: exponent {metric.value:.2f}", fontsize=10)
    _ticks(axis)
    axis.set_xticks(size, [f"{value:.4g}" for value in size])


def _ticks(axis: Axes) -> None:
    """Plain numbers at 1, 2 and 5 where an axis has few decades: matplotlib's own powers of ten run into each other."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for line, (low, high) in ((axis.xaxis, axis.get_xlim()), (axis.yaxis, axis.get_ylim())):
        line.set_minor_locator(NullLocator())
        if high / low < FEW_DECADES:
            line.set_major_locator(LogLocator(subs=(1, 2, 5)))
            line.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.grid(alpha=0.3)
