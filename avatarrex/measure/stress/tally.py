"""The summary of a run: for each check how many cases it saw, the worst figure, its tolerance and its failures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from avatarrex.measure.stress.findings import Finding


@dataclass
class Row:
    """One check of one kind of case."""

    tolerance: float
    cases: int = 0
    failures: int = 0
    worst: float = -math.inf
    worst_case: int = 0


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
            if finding.check not in worst or _excess(finding) > _excess(worst[finding.check]):
                worst[finding.check] = finding
        for finding in worst.values():
            row = self.rows.setdefault((kind, finding.check), Row(finding.tolerance))
            row.cases += 1
            row.failures += finding.failed
            if finding.figure > row.worst:
                row.worst, row.worst_case = finding.figure, number
                row.tolerance = finding.tolerance

    @property
    def failures(self) -> int:
        """Failed checks of all cases."""
        return sum(row.failures for row in self.rows.values())

    def text(self) -> str:
        """The table, and what the cases cost."""
        wide = max((len(check) for _, check in self.rows), default=5)
        lines = [f"{'case':9}  {'check':{wide}}  {'cases':>6}  {'worst':>9}  {'tolerance':>9}  {'failures':>8}"]
        for (kind, check), row in self.rows.items():
            figures = f"{row.cases:6d}  {row.worst:9.3g}  {row.tolerance:9.3g}  {row.failures or '':>8}"
            lines.append(f"{kind:9}  {check:{wide}}  {figures}")
        cost = (
            f"{count} {kind} ({1000 * self.cpu_seconds[kind] / count:.0f} s per 1000)"
            for kind, count in self.cases.items()
        )
        return "\n".join([*lines, "", "processor time: " + ", ".join(cost)])

    def to_json(self) -> dict[str, Any]:
        """The same as plain values; a figure that is no number is null."""
        checks = [
            {
                "case": kind,
                "check": check,
                "cases": row.cases,
                "worst": row.worst if math.isfinite(row.worst) else None,
                "worst_case": row.worst_case,
                "tolerance": row.tolerance,
                "failures": row.failures,
            }
            for (kind, check), row in self.rows.items()
        ]
        return {"cases": self.cases, "cpu_seconds": self.cpu_seconds, "checks": checks, "failures": self.failures}


def _excess(finding: Finding) -> float:
    return finding.figure - finding.tolerance
