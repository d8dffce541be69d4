"""Curves of runs: one plot per number or group of numbers, by step or by time, smoothed, with their values at the cursor.

Smoothing is the exponential mean of TensorBoard, free of the bias of its start: y_k = Σ s^i x_{k−i} / Σ s^i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from avatarrex_studio.panels import theme
from imgui_bundle import imgui, implot
from jaxtyping import Float64
from scipy.signal import lfilter

from avatarrex.training.events import Series

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
    colour: tuple[float, float, float]
    series: Series


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
        imgui.text_colored(theme.vec4(theme.MUTED), "Smoothing")
        imgui.same_line()
        imgui.set_next_item_width(110)
        _, self.smoothing = imgui.slider_float("##smoothing", self.smoothing, 0.0, 0.99, "%.2f")
        imgui.same_line(0, 14)
        _, self.by_time = imgui.checkbox("By time", self.by_time)
        imgui.same_line(0, 14)
        _, self.following = imgui.checkbox("Follow", self.following)
        if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
            imgui.set_tooltip("Axes go along with new values; wheel or drag a plot to look closer")

    def plot(self, title: str, lines: Sequence[Line], size: tuple[float, float], log: bool = False,
             form: str = "%.4g") -> None:  # fmt: skip
        """A titled plot of `lines` of `size` points; `log`: a logarithmic axis, which values ≤ 0 are not on."""
        context()
        imgui.begin_group()
        imgui.text_colored(theme.vec4(theme.TEXT), title)
        if len(lines) == 1:
            _value(lines[0], form, size[0])
        else:
            _legend(lines, size[0])
        flags = implot.Flags_.no_title | implot.Flags_.no_legend | implot.Flags_.no_menus
        flags |= implot.Flags_.no_mouse_text | implot.Flags_.no_box_select
        height = size[1] - imgui.get_text_line_height_with_spacing()
        if implot.begin_plot(f"##{title}", imgui.ImVec2(size[0], height), flags):
            self._content(lines, log, form)
            implot.end_plot()
        imgui.end_group()

    def _content(self, lines: Sequence[Line], log: bool, form: str) -> None:
        fit = implot.AxisFlags_.auto_fit if self.following else implot.AxisFlags_.none
        implot.setup_axes("", "", implot.AxisFlags_.no_label | fit, implot.AxisFlags_.no_label | fit)
        if log:
            implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.log10)
        if self.by_time:
            implot.setup_axis_format(implot.ImAxis_.x1, "%g min")
        drawn = [(line, self._x(line.series), self._y(line.series, log)) for line in lines]
        for line, x, y in drawn:
            if self.smoothing > 0 and len(x) > 1:
                _draw(f"##raw {line.label}", x, _shown(line.series.values, log), (*line.colour, 0.22), 1.0)
            _draw(line.label, x, y, (*line.colour, 1.0), 1.8)
        if not implot.is_plot_hovered():
            return
        if imgui.is_mouse_dragging(imgui.MouseButton_.left) or imgui.get_io().mouse_wheel:
            self.following = False
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            self.following = True
        self._tip(drawn, form)

    def _tip(self, drawn: Sequence[tuple[Line, np.ndarray, np.ndarray]], form: str) -> None:
        """The values at the cursor."""
        place = implot.get_plot_mouse_pos().x
        imgui.begin_tooltip()
        imgui.text_colored(theme.vec4(theme.MUTED), f"{place:.1f} min" if self.by_time else f"step {place:,.0f}")
        for line, x, y in drawn:
            if len(x):
                nearest = int(np.abs(x - place).argmin())
                imgui.text_colored(theme.vec4(line.colour), line.label)
                imgui.same_line(0, 12)
                imgui.text(form % y[nearest])
        imgui.end_tooltip()

    def _x(self, series: Series) -> Float64[np.ndarray, "p"]:
        return (series.times - series.times[:1]) / 60 if self.by_time else series.steps.astype(np.float64)

    def _y(self, series: Series, log: bool) -> Float64[np.ndarray, "p"]:
        known, amount, values = self._cache.get(id(series), (None, 0.0, series.values))
        if known is not series or amount != self.smoothing:
            if len(self._cache) > 512:
                self._cache.clear()
            values = smoothed(series.values, self.smoothing)
            self._cache[id(series)] = series, self.smoothing, values
        return _shown(values, log)


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
    style.plot_padding = imgui.ImVec2(4, 6)
    style.label_padding = imgui.ImVec2(4, 3)
    style.fit_padding = imgui.ImVec2(0.0, 0.06)
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


def _value(line: Line, form: str, width: float) -> None:
    """The last value at the right end of the title's line."""
    if len(line.series.values):
        text = form % line.series.values[-1]
        imgui.same_line(imgui.get_cursor_pos_x() + width - imgui.calc_text_size(text).x)
        imgui.text_colored(theme.vec4(line.colour), text)


def _legend(lines: Sequence[Line], width: float) -> None:
    """Coloured labels after the title, as many as fit."""
    left = imgui.get_cursor_pos_x()
    for line in lines:
        imgui.same_line(0, 12)
        if imgui.get_cursor_pos_x() + imgui.calc_text_size(line.label).x > left + width:
            imgui.text_colored(theme.vec4(theme.MUTED), "…")
            break
        imgui.text_colored(theme.vec4(line.colour), line.label)
