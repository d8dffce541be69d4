"""The machine and its metrics: a run as a table to read and as JSON to keep (targets: docs/bench.md).

{"device": {…}, "mode": "quick" | "full", "metrics": [{"name", "value", "unit", "direction", "error", "target",
 "tolerance"}, …], "absent": {name: why}}

A metric's unit says how a gate may judge it: times depend on the machine, ratios were taken within one run, everything
else (errors, counts, sizes) is what it is. The machine is described as far as figures depend on it; no names of hosts or users.
"""

from __future__ import annotations

import math
import os
import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from avatarrex.errors import InputError
from avatarrex.files.json_text import read_json
from avatarrex.gl.context import gl_context, gl_unavailable, renderer_name
from avatarrex.metrics.table import aligned

TIMES = ("ms", "fps")
FASTER, SLOWER = "× as fast", "× the time"
RATIOS = (FASTER, SLOWER)
TOLERANCE = 0.25
"""Relative. Ratios of two times in one run drift by this much on a shared 2-core machine."""


@dataclass(frozen=True)
class Metric:
    """A figure."""

    name: str
    """`stage.what`, or `stage.case.contestant.ms` where several do the same work."""
    value: float
    unit: str
    direction: Literal["lower", "higher"] = "lower"
    """Which way is better."""
    error: dict[str, Any] | None = None
    """The error that this time or ratio comes with, and what else is needed to read it."""
    target: float | None = None
    tolerance: float = TOLERANCE
    """Share by which a later value may be worse."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise ArithmeticError(f"{self.name} is {self.value}")

    @property
    def kind(self) -> Literal["time", "ratio", "error"]:
        """What a gate may do with it."""
        return "time" if self.unit in TIMES else "ratio" if self.unit in RATIOS else "error"

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        return self.value <= self.target if self.direction == "lower" else self.value >= self.target


def describe(networks: str = "cpu") -> dict[str, Any]:
    """Processor, cores, threads, renderer, GPU, versions, and where the networks of whole frames run."""
    missing = gl_unavailable()
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {
        "cpu": cpu(),
        "vectors": torch.backends.cpu.get_cpu_capability(),
        "cores": cores(),
        "threads": torch.get_num_threads(),
        "renderer": renderer_name(gl_context()) if missing is None else f"none: {missing}",
        "gpu": gpu,
        "networks": networks,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "system": platform.system(),
    }


def device_class(device: dict[str, Any]) -> str:
    """Machines with comparable ratios, as a file's name: `linux-2-cores-avx2-llvmpipe`."""
    drawn = re.split(r"[ (/:]", str(device["renderer"]))[0] or "none"
    words = [device["system"], f"{device['cores']}-cores", device["vectors"], device["gpu"] or drawn]
    placed = device.get("networks", "cpu")
    words += [] if placed == "cpu" else ["networks", "on", placed]
    return re.sub(r"[^a-z0-9]+", "-", " ".join(words).lower()).strip("-")


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cpu() -> str:
    """The processor's name."""
    listed = Path("/proc/cpuinfo")
    if listed.is_file():
        found = re.search(r"^model name\s*:\s*(.+)$", listed.read_text(), re.MULTILINE)
        if found:
            return found[1]
    return platform.processor() or platform.machine()


HEADS = ("metric", "value", "unit", "target", "", "error")
SHOWN = ("max_error_m", "sign_errors", "max_error", "mean_error_mm", "p99_error_mm", "missed", "false", "depth_mean_mm",
         "depth_p99_mm", "flips", "iou", "colour_psnr_db", "psnr_db", "their_psnr_db", "changed_crossings", "largest_deviation",
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

    def over(self, old: Report, stages: Sequence[str]) -> Report:
        """This run of `stages`, with what `old`, a run of the same size, has of other stages."""
        kept = [metric for metric in old.metrics if metric.name.split(".")[0] not in stages]
        absent = {name: why for name, why in old.absent.items() if name.split(".")[0] not in stages}
        return replace(self, metrics=[*kept, *self.metrics], absent={**absent, **self.absent})

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
