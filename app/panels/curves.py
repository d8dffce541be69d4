"""Curves of runs: a plot for each number or group of numbers, by step or by time, smoothed, with their values at the cursor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.curve_data import log_ticks, smoothed, span, step_ticks, thinned
from imgui_bundle import imgui, implot
from jaxtyping import Float64

from avatarrex.training.runs.events import Series

FAINT = 0.25
"""Opacity of values that are smoothed, as they were."""


@dataclass(frozen=True)
class Line:
    """What one curve shows."""

    label: str
    colour: theme.Rgb
    series: Series


@dataclass(frozen=True)
class Chart:
    """How one plot is drawn."""

    title: str
    form: str = "%.4g"
    log: bool = False
    """Whether the axis is logarithmic; values ≤ 0 are not on it."""
    named: bool = False
    """Whether the lines' names are beside the title, else their last values."""
    smooth: bool = False
    """Whether smoothed values are drawn over the values as they were."""


class Curves:
    """How all the plots of a panel are drawn."""

    def __init__(self) -> None:
        self.smoothing = 0.6
        self.by_time = False
        self.following = True
        """Whether the axes go along with new values; ends when a user zooms or drags a plot."""
        self._cache: dict[int, tuple[Series, float, np.ndarray]] = {}

    def options(self) -> None:
        """The row of settings over the plots."""
        imgui.align_text_to_frame_padding()
        widgets.caption("Smoothing")
        imgui.same_line()
        imgui.set_next_item_width(110)
        _, self.smoothing = imgui.slider_float("##smoothing", self.smoothing, 0.0, 0.99, "%.2f")
        imgui.same_line(0, 14)
        _, self.by_time = imgui.checkbox("By time", self.by_time)
        imgui.same_line(0, 14)
        _, self.following = imgui.checkbox("Follow", self.following)
        widgets.tooltip("Axes go along with new values; wheel or drag a plot to look closer")

    def plot(self, chart: Chart, lines: Sequence[Line], size: tuple[float, float]) -> None:
        """A titled plot of `lines`, `size` points large."""
        context()
        imgui.begin_group()
        widgets.caption(chart.title, theme.TEXT)
        _names(lines, size[0]) if chart.named else _values(lines, chart.form, size[0])
        flags = implot.Flags_.no_title | implot.Flags_.no_legend | implot.Flags_.no_menus
        flags |= implot.Flags_.no_mouse_text | implot.Flags_.no_box_select
        height = size[1] - imgui.get_text_line_height_with_spacing()
        if implot.begin_plot(f"##{chart.title}", (size[0], height), flags):
            self._content(chart, lines)
            implot.end_plot()
        imgui.end_group()

    def _content(self, chart: Chart, lines: Sequence[Line]) -> None:
        smooth = chart.smooth and self.smoothing > 0
        raw = [(line, self._x(line.series), _shown(line.series.values, chart.log)) for line in lines]
        drawn = [(line, x, _shown(self._smoothed(line.series), chart.log)) for line, x, _ in raw] if smooth else raw
        self._axes([x for _, x, _ in raw], [y for *_, y in (*raw, *drawn)], chart.log)
        for line, x, y in raw if smooth else ():
            _draw(f"##raw {line.label}", x, y, theme.vec4(line.colour, FAINT), 1.0)
        for line, x, y in drawn:
            _draw(line.label, x, y, theme.vec4(line.colour), 1.8)
        if not implot.is_plot_hovered():
            return
        if imgui.is_mouse_dragging(imgui.MouseButton_.left) or imgui.get_io().mouse_wheel:
            self.following = False
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            self.following = True
        self._tip(drawn, chart.form)

    def _axes(self, xs: Sequence[np.ndarray], ys: Sequence[np.ndarray], log: bool) -> None:
        """Both axes around all values while they are followed, else where the user left them."""
        bare = implot.AxisFlags_.no_label
        implot.setup_axes("", "", bare, bare)
        left, right = span(xs, 0.0, False)
        low, high = span(ys, 0.06, log)
        condition = implot.Cond_.always if self.following else implot.Cond_.once
        implot.setup_axes_limits(left, right, low, high, condition)
        implot.setup_axis_format(implot.ImAxis_.x1, "%g min" if self.by_time else "%g")
        if self.following and not self.by_time:
            steps = step_ticks(left, right)
            implot.setup_axis_ticks(implot.ImAxis_.x1, steps, [f"{step:,.0f}" for step in steps])
        if log:
            implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.log10)
            if self.following:
                ticks = log_ticks(low, high)
                implot.setup_axis_ticks(implot.ImAxis_.y1, ticks, [f"{tick:.3g}" for tick in ticks])

    def _tip(self, drawn: Sequence[tuple[Line, np.ndarray, np.ndarray]], form: str) -> None:
        """The values at the cursor."""
        place = implot.get_plot_mouse_pos().x
        imgui.begin_tooltip()
        widgets.caption(f"{place:.1f} min" if self.by_time else f"step {place:,.0f}")
        for line, x, y in drawn:
            if len(x):
                nearest = int(np.abs(x - place).argmin())
                widgets.caption(line.label, line.colour)
                imgui.same_line(0, 12)
                imgui.text(form % y[nearest])
        imgui.end_tooltip()

    def _x(self, series: Series) -> Float64[np.ndarray, "p"]:
        return (series.times - series.times[:1]) / 60 if self.by_time else series.steps.astype(np.float64)

    def _smoothed(self, series: Series) -> Float64[np.ndarray, "p"]:
        known, amount, values = self._cache.get(id(series), (None, 0.0, series.values))
        if known is not series or amount != self.smoothing:
            if len(self._cache) > 512:
                self._cache.clear()
            values = smoothed(series.values, self.smoothing)
            self._cache[id(series)] = series, self.smoothing, values
        return values


def context() -> None:
    """The plot library's own context and colours, made once per interface context."""
    if implot.get_current_context() is not None:
        return
    implot.create_context()
    sizes: dict[str, theme.Size] = {
        "plot_padding": (12, 6), "label_padding": (4, 3), "plot_border_size": 0, "minor_alpha": 0.35,
        "major_tick_len": (0, 0), "minor_tick_len": (0, 0),
    }  # fmt: skip
    colours: dict[str, theme.Rgba] = {
        "frame_bg": (*theme.TEXT, 0.0), "plot_bg": (*theme.BASE, 1.0), "plot_border": (0, 0, 0, 0),
        "axis_text": (*theme.MUTED, 1.0), "axis_grid": (*theme.MUTED, 0.18), "axis_bg_hovered": (*theme.TEXT, 0.05),
        "axis_bg_active": (*theme.ACCENT, 0.15), "crosshairs": (*theme.MUTED, 0.6),
    }  # fmt: skip
    theme.dress(implot.get_style(), implot.Col_, sizes, colours)


def close() -> None:
    """Give the plot library's context back; before the interface's own goes."""
    if implot.get_current_context() is not None:
        implot.destroy_context()


def _shown(values: np.ndarray, log: bool) -> np.ndarray:
    return np.where(values > 0, values, np.nan) if log else values


def _draw(label: str, x: np.ndarray, y: np.ndarray, colour: imgui.ImVec4, weight: float) -> None:
    finite = np.isfinite(y)
    x, y = thinned(x[finite], y[finite])
    spec = implot.Spec()
    spec.line_color, spec.line_weight = colour, weight
    if len(x) == 1:
        spec.marker, spec.marker_size = implot.Marker_.circle, 3.0
        spec.marker_fill_color = spec.marker_line_color = colour
        implot.plot_scatter(label, x, y, spec)
    elif len(x):
        implot.plot_line(label, x, y, spec)


def _values(lines: Sequence[Line], form: str, width: float) -> None:
    """The last values at the right end of the title's line, as far as there is room."""
    texts = [(form % line.series.values[-1], line.colour) for line in lines if len(line.series.values)]
    title, gap = imgui.get_item_rect_size().x, 8.0
    while texts and title + sum(imgui.calc_text_size(text).x + gap for text, _ in texts) > width:
        texts.pop()
    space = width - title - sum(imgui.calc_text_size(text).x for text, _ in texts) - gap * (len(texts) - 1)
    for text, colour in texts:
        imgui.same_line(0, space)
        widgets.caption(text, colour)
        space = gap


def _names(lines: Sequence[Line], width: float) -> None:
    """Coloured names after the title, as many as fit."""
    used = imgui.get_item_rect_size().x
    for line in lines:
        used += imgui.calc_text_size(line.label).x + 12
        imgui.same_line(0, 12)
        if used > width:
            widgets.caption("…")
            break
        widgets.caption(line.label, line.colour)
