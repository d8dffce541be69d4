"""What a curve shows of a series: smoothed values, few enough points, the span and the ticks of its axis.

Smoothing is the exponential mean of TensorBoard, free of the bias of its start: y_k = Σ s^i x_{k−i} / Σ s^i.
Letters: p points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

MOST_POINTS = 1500
"""Of a curve that are drawn; more would not be seen."""


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


def step_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Whole numbers from `low` to `high`, 1, 2 or 5 times a power of ten apart, at most `most`."""
    width = max((high - low) / (most - 1), 1.0)
    power = 10.0 ** np.floor(np.log10(width))
    step = next(part * power for part in (1, 2, 5, 10) if part * power >= width)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def smoothed(values: Float64[np.ndarray, "p"], amount: float) -> Float64[np.ndarray, "p"]:
    """The exponential mean, `amount` in [0, 1); a value that is not finite stays one and leaves the rest alone."""
    finite = np.isfinite(values)
    clean, result = values[finite], values.copy()
    if amount > 0 and len(clean):
        from scipy.signal import lfilter  # takes 0.25 s: not before there is a curve

        weight = 1 - amount ** np.arange(1, len(clean) + 1)
        result[finite] = lfilter([1 - amount], [1, -amount], clean) / weight
    return result


def thinned(
    x: Float64[np.ndarray, "p"], y: Float64[np.ndarray, "p"], points: int = MOST_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """At most about `points` of a curve: of each piece its lowest and its highest, so that no peak is lost."""
    if len(x) <= points:
        return x, y
    pieces = np.array_split(np.arange(len(x)), points // 2)
    low = [piece[np.where(np.isfinite(y[piece]), y[piece], np.inf).argmin()] for piece in pieces]
    high = [piece[np.where(np.isfinite(y[piece]), y[piece], -np.inf).argmax()] for piece in pieces]
    keep = np.unique([0, len(x) - 1, *low, *high])
    return x[keep], y[keep]
