"""What the checks of a case found: a figure for each, compared with its tolerance; and the summary of a run.

A digest of every number seen tells whether the same case gave the same bits again. A figure that is not a number fails any
tolerance. The summary has for each check how many cases it saw, the worst figure, its tolerance and its failures.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from avatarrex.metrics.table import aligned


@dataclass(frozen=True)
class Finding:
    """One check of one case."""

    check: str
    figure: float
    tolerance: float
    note: str = ""

    @property
    def excess(self) -> float:
        """By how much the figure exceeds the tolerance."""
        return self.figure - self.tolerance

    @property
    def failed(self) -> bool:
        """Whether the figure exceeds the tolerance or is no number."""
        return not self.figure <= self.tolerance


class Findings:
    """Collects the findings of one case."""

    def __init__(self) -> None:
        self.found: list[Finding] = []
        self._digest = hashlib.blake2b(digest_size=16)

    @property
    def digest(self) -> str:
        """Of all tensors that `finite` has seen."""
        return self._digest.hexdigest()

    def at_most(self, check: str, figure: Tensor | np.ndarray | float, tolerance: float, note: str = "") -> None:
        """The largest of `figure` (0 where it is empty) is at most `tolerance`."""
        values = torch.as_tensor(figure)
        worst = float(values.max()) if values.numel() else 0.0
        # torch's max hands NaN on
        self.found.append(Finding(check, math.inf if math.isnan(worst) else worst, tolerance, note))

    def finite(self, check: str, *tensors: Tensor | np.ndarray) -> None:
        """No NaN and no Inf; the figure counts them."""
        bad = 0
        for tensor in tensors:
            value = torch.as_tensor(tensor).detach().contiguous()
            self._digest.update(value.numpy().tobytes())
            bad += int((~torch.isfinite(value)).sum())
        self.at_most(check, float(bad), 0)

    def within(self, check: str, values: Tensor, low: float, high: float, tolerance: float = 0.0) -> None:
        """`low` ≤ values ≤ `high`; the figure is how far the worst lies outside."""
        self.at_most(check, torch.maximum(low - values, values - high).clamp_min(0), tolerance)

    def unit(self, check: str, vectors: Tensor, tolerance: float) -> None:
        """Vectors (…, 3) of length one; the figure is the worst difference."""
        self.at_most(check, (vectors.double().norm(dim=-1) - 1).abs(), tolerance)

    def flag(self, check: str, ok: bool, note: str = "") -> None:
        """A yes or no: 0 where `ok`, else 1, tolerance 0."""
        self.at_most(check, float(not ok), 0, note)


HEADS = ("case", "check", "cases", "worst", "tolerance", "failures")


@dataclass
class Row:
    """One check of one kind of case."""

    case: str
    check: str
    cases: int = 0
    worst: float = -math.inf
    worst_case: int = 0
    tolerance: float = 0.0
    failures: int = 0

    def add(self, number: int, finding: Finding) -> None:
        """What one more case gave."""
        self.cases += 1
        self.failures += finding.failed
        if finding.figure > self.worst or self.cases == 1:
            self.tolerance = finding.tolerance
        if finding.figure > self.worst:
            self.worst, self.worst_case = finding.figure, number


@dataclass
class Tally:
    """Grows by the findings of case after case."""

    rows: dict[tuple[str, str], Row] = field(default_factory=dict)
    cases: dict[str, int] = field(default_factory=dict)
    cpu_seconds: dict[str, float] = field(default_factory=dict)

    def add(self, kind: str, number: int, findings: list[Finding], cpu_seconds: float) -> None:
        """The findings of one case; a check that a case makes several times counts once."""
        self.cases[kind] = self.cases.get(kind, 0) + 1
        self.cpu_seconds[kind] = self.cpu_seconds.get(kind, 0.0) + cpu_seconds
        worst: dict[str, Finding] = {}
        for finding in findings:
            known = worst.setdefault(finding.check, finding)
            if finding.excess > known.excess:
                worst[finding.check] = finding
        for check, finding in worst.items():
            self.rows.setdefault((kind, check), Row(kind, check)).add(number, finding)

    @property
    def failures(self) -> int:
        """Failed checks of all cases."""
        return sum(row.failures for row in self.rows.values())

    def text(self) -> str:
        """The table, and what the cases cost."""
        rows = (
            (row.case, row.check, str(row.cases), f"{row.worst:.3g}", f"{row.tolerance:.3g}", str(row.failures or ""))
            for row in self.rows.values()
        )
        cost = (f"{n} {kind} ({1000 * self.cpu_seconds[kind] / n:.0f} s per 1000)" for kind, n in self.cases.items())
        return "\n".join([*aligned([HEADS, *rows], range(2, 6)), "", "processor time: " + ", ".join(cost)])

    def to_json(self) -> dict[str, Any]:
        """The same as plain values; a figure that is no number is null."""
        checks = [
            asdict(row) | {"worst": row.worst if math.isfinite(row.worst) else None} for row in self.rows.values()
        ]
        return {"cases": self.cases, "cpu_seconds": self.cpu_seconds, "checks": checks, "failures": self.failures}
