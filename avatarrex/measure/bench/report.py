"""A run as a table to read and as JSON to keep.

{"device": {…}, "mode": "quick" | "full", "metrics": [{"name", "value", "unit", "direction", "error", "target",
 "tolerance"}, …], "absent": {name: why}}
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avatarrex.errors import InputError
from avatarrex.files.json_text import read_json
from avatarrex.measure.bench.device import describe
from avatarrex.measure.bench.metric import Metric
from avatarrex.metrics.table import aligned

HEADS = ("metric", "value", "unit", "target", "", "error")
SHOWN = ("max_error_m", "sign_errors", "max_error", "mean_error_mm", "p99_error_mm", "missed", "false", "depth_mean_mm",
         "depth_p99_mm", "flips", "colour_psnr_db", "psnr_db", "their_psnr_db", "changed_crossings", "largest_deviation",
         "note")  # fmt: skip
"""What of an error a line of the table has room for; all of it is in the JSON."""


@dataclass(frozen=True)
class Report:
    """What one run found."""

    device: dict[str, Any]
    mode: str
    metrics: list[Metric]
    absent: dict[str, str]

    @staticmethod
    def of(metrics: list[Metric], absent: dict[str, str], quick: bool, networks: str = "cpu") -> Report:
        """A run on this machine, `networks` of whole frames on that device."""
        return Report(describe(networks), "quick" if quick else "full", metrics, absent)

    def named(self, name: str) -> Metric | None:
        """None where it was not measured."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    @staticmethod
    def read(path: str | Path) -> Report:
        """What `bench --json` wrote. Raises `InputError`."""
        data = read_json(path, "what `bench --record` wrote")
        try:
            metrics = [Metric(**one) for one in data["metrics"]]
            return Report(dict(data["device"]), str(data["mode"]), metrics, dict(data.get("absent", {})))
        except (KeyError, TypeError, ValueError, ArithmeticError) as error:
            raise InputError(path, "", "what `bench --record` wrote", f"{type(error).__name__}: {error}") from None

    def table(self) -> str:
        """Everything, aligned; then what could not be measured."""
        rows = [HEADS, *(_row(metric) for metric in self.metrics)]
        lines = [f"{key}: {value}" for key, value in self.device.items()]
        lines += ["", *aligned(rows, right=(1,))]
        if self.absent:
            lines += ["", "not measured", *aligned([(name, why) for name, why in sorted(self.absent.items())])]
        return "\n".join(lines)


def figure(value: float) -> str:
    """Four digits."""
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _row(metric: Metric) -> tuple[str, ...]:
    sign = "≤" if metric.direction == "lower" else "≥"
    target = "" if metric.target is None else f"{sign} {figure(metric.target)}"
    verdict = {None: "", True: "met", False: "MISSED"}[metric.met]
    return metric.name, figure(metric.value), metric.unit, target, verdict, _errors(metric.error or {})


def _errors(error: dict[str, Any]) -> str:
    shown = {key: error[key] for key in SHOWN if key in error}
    return ", ".join(
        f"{key} {figure(value) if isinstance(value, int | float) else value}" for key, value in shown.items()
    )
