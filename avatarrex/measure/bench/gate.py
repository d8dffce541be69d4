"""Has anything become worse than the baseline that is committed for this class of machine?

- **Errors, counts, sizes** may be as large as their target or as the baseline's value with its tolerance, whichever is more.
- **Ratios** of one run may be worse than the baseline's by the tolerance.
- **Times** only inform: another day, another machine.

What the baseline has and this run measured no more is a failure, unless its whole stage was not run.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from avatarrex.errors import check
from avatarrex.measure.bench.report import Metric, Report, device_class, figure
from avatarrex.metrics.table import aligned

BASELINES = Path("avatarrex/measure/baselines")


@dataclass(frozen=True)
class Verdict:
    """Of one metric."""

    name: str
    before: float
    now: float | None
    """None: not measured any more."""
    limit: float | None
    """None: a time."""
    passed: bool
    why: str = ""


def baseline_path(report: Report) -> Path:
    """Where the baseline of this machine's class lies, in the checkout."""
    return BASELINES / f"{device_class(report.device)}.{report.mode}.json"


def read_baseline(path: Path, report: Report) -> Report:
    """Raises `InputError` where there is none, or one of another size."""
    baseline = Report.read(path)
    check(baseline.mode == report.mode, path, "mode", f"{report.mode}, as this run", baseline.mode)
    return baseline


def compare(report: Report, baseline: Report, stages: list[str]) -> list[Verdict]:
    """A verdict on every metric of the baseline of a stage that was run."""
    return [_verdict(old, report) for old in baseline.metrics if old.name.split(".")[0] in stages]


def table(verdicts: list[Verdict], path: Path) -> str:
    """Failures first; times are not shown."""
    ranked = sorted((v for v in verdicts if v.limit is not None or not v.passed), key=lambda v: v.passed)
    rows: list[tuple[str, ...]] = [("", "now", "baseline", "limit", "metric")]
    for v in ranked:
        now, limit = ("–" if value is None else figure(value) for value in (v.now, v.limit))
        what = f"{v.name}: {v.why}" if v.why else v.name
        rows.append(("ok" if v.passed else "FAIL", now, figure(v.before), limit, what))
    failed = sum(not v.passed for v in verdicts)
    verdict = f"gate: {failed} of {len(ranked)} failed" if failed else f"gate: {len(ranked)} passed"
    return "\n".join([*aligned(rows, right=(1,)), f"{verdict}, against {path}"])


def limit_of(old: Metric, now: Metric) -> float | None:
    """The worst value that passes; None for a time."""
    if now.kind == "time":
        return None
    lower, slack = old.direction == "lower", old.tolerance * abs(old.value)
    worst = old.value + slack if lower else old.value - slack
    if now.kind == "ratio" or now.target is None:
        return worst
    return (max if lower else min)(worst, now.target)


def _verdict(old: Metric, report: Report) -> Verdict:
    now = report.named(old.name)
    if now is None:
        optional = old.name.startswith("peers.") or old.kind == "time"
        why = "" if optional else report.absent.get(old.name, "not measured any more")
        return Verdict(old.name, old.value, None, None, optional, why)
    limit = limit_of(old, now)
    passed = limit is None or (now.value <= limit if old.direction == "lower" else now.value >= limit)
    return Verdict(old.name, old.value, now.value, limit, passed)
