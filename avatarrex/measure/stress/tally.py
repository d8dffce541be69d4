"""The summary of a run: for each check how many cases it saw, the worst figure, its tolerance and its failures."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from avatarrex.measure.stress.findings import Finding
from avatarrex.metrics.table import aligned

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
