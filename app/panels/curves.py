"""Curves of runs: a plot for each number or group of numbers, by step or by time, smoothed, with their values at the cursor.

Smoothing is the exponential mean of TensorBoard, free of the bias of its start: y_k = Σ s^i x_{k−i} / Σ s^i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import imgui, implot
from jaxtyping import Float64
from scipy.signal import lfilter

from avatarrex.training.runs.events import Series

POINTS = 1500
"""Of a curve that are drawn; more would not be seen."""
COLOURS = (
    (0.31, 0.63, 0.98), (0.96, 0.64, 0.33), (0.47, 0.79, 0.50), (0.85, 0.50, 0.78), (0.91, 0.81, 0.42),
    (0.38, 0.80, 0.80), (0.93, 0.46, 0.46), (0.62, 0.57, 0.96),
)  # fmt: skip
"""Of runs and of loss terms, the accent first."""


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
            _draw(f"##raw {line.label}", x, y, (*line.colour, 0.22), 1.0)
        for line, x, y in drawn:
            _draw(line.label, x, y, (*line.colour, 1.0), 1.8)
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
        implot.setup_axis_format(implot.ImAxis_.x1, "%g min" if self.by_time else "%.0f")
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


def span(values: Sequence[Float64[np.ndarray, "_"]], share: float, log: bool) -> tuple[float, float]:
    """Lowest and highest of all finite values with `share` of their distance added, by ratio where `log`."""
    finite = np.concatenate([np.zeros(0), *(entry[np.isfinite(entry)] for entry in values)])
    if not len(finite):
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(finite.min()), float(finite.max())
    if log:
        spread = max(high / low, 1.25) ** share if high > 1.25 * low else 1.12
        return low / spread, high * spread
    pad = share * (high - low) if high > low else max(0.05 * abs(low), 0.5 * (share == 0), 1e-12)
    return low - pad, high + pad


def log_ticks(low: float, high: float) -> list[float]:
    """Round numbers on a logarithmic axis: powers of ten where there are many, else 1, 2 and 5, else even ratios."""
    exponents = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    decades = [10.0**k for k in exponents if low <= 10.0**k <= high]
    if len(decades) >= 4:
        return decades[:: -(-len(decades) // 7)]
    ticks = [step * 10.0**k for k in exponents for step in (1, 2, 5) if low <= step * 10.0**k <= high]
    return ticks if len(ticks) >= 2 else [float(f"{tick:.2g}") for tick in np.geomspace(low, high, 5)[1:-1]]


def smoothed(values: Float64[np.ndarray, "p"], amount: float) -> Float64[np.ndarray, "p"]:
    """The exponential mean, `amount` in [0, 1); a value that is not finite stays one and leaves the rest alone."""
    finite = np.isfinite(values)
    clean, result = values[finite], values.copy()
    if amount > 0 and len(clean):
        weight = 1 - amount ** np.arange(1, len(clean) + 1)
        result[finite] = lfilter([1 - amount], [1, -amount], clean) / weight
    return result


def thinned(
    x: Float64[np.ndarray, "p"], y: Float64[np.ndarray, "p"], points: int = POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """At most about `points` of a curve: of each piece its lowest and its highest, so that no peak is lost."""
    if len(x) <= points:
        return x, y
    pieces = np.array_split(np.arange(len(x)), points // 2)
    low = [piece[np.where(np.isfinite(y[piece]), y[piece], np.inf).argmin()] for piece in pieces]
    high = [piece[np.where(np.isfinite(y[piece]), y[piece], -np.inf).argmax()] for piece in pieces]
    keep = np.unique([0, len(x) - 1, *low, *high])
    return x[keep], y[keep]


def context() -> None:
    """The plot library's own context and colours, made once per interface context."""
    if implot.get_current_context() is not None:
        return
    implot.create_context()
    style = implot.get_style()
    style.plot_padding = imgui.ImVec2(12, 6)
    style.label_padding = imgui.ImVec2(4, 3)
    style.plot_border_size = 0
    style.minor_alpha = 0.35
    style.major_tick_len = style.minor_tick_len = imgui.ImVec2(0, 0)
    colours = {
        "frame_bg": (*theme.TEXT, 0.0), "plot_bg": (0.094, 0.102, 0.118, 1.0), "plot_border": (0, 0, 0, 0),
        "axis_text": (*theme.MUTED, 1.0), "axis_grid": (*theme.MUTED, 0.18), "axis_bg_hovered": (*theme.TEXT, 0.05),
        "axis_bg_active": (*theme.ACCENT, 0.15), "crosshairs": (*theme.MUTED, 0.6),
    }  # fmt: skip
    for name, value in colours.items():
        style.set_color_(getattr(implot.Col_, name), imgui.ImVec4(*value))


def close() -> None:
    """Give the plot library's context back; before the interface's own goes."""
    if implot.get_current_context() is not None:
        implot.destroy_context()


def _shown(values: np.ndarray, log: bool) -> np.ndarray:
    return np.where(values > 0, values, np.nan) if log else values


def _draw(label: str, x: np.ndarray, y: np.ndarray, colour: tuple[float, ...], weight: float) -> None:
    finite = np.isfinite(y)
    x, y = thinned(x[finite], y[finite])
    spec = implot.Spec()
    spec.line_color, spec.line_weight = imgui.ImVec4(*colour), weight
    if len(x) == 1:
        spec.marker, spec.marker_size = implot.Marker_.circle, 3.0
        spec.marker_fill_color = spec.marker_line_color = imgui.ImVec4(*colour)
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
