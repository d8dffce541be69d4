"""Figures by matplotlib, an optional package, as PNG files."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from avatarrex.errors import check
from avatarrex.files.gate import written

Axes = Any
"""`matplotlib.axes.Axes`: an optional package is not imported for its names."""


def require_matplotlib() -> None:
    """Raises `InputError` where it is not installed."""
    check(find_spec("matplotlib"), "--plot", "", "matplotlib: pip install 'avatarrex-studio[bench]'", "none")


def axes_beside(count: int, inches: tuple[float, float], sharey: bool = False) -> tuple[list[Axes], Any]:
    """`count` axes in a row, and their figure of so many inches. Raises `InputError` without matplotlib."""
    require_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, layout="constrained")
    return list(figure.subplots(1, count, sharey=sharey, squeeze=False)[0]), figure


def save(figure: Any, path: Path, dpi: int = 130) -> Path:
    """Write a PNG, whole or not at all."""
    with written(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format="png")
    return path
