"""Run time against error, here and now: stages of measurement as a table, JSON, plots, and a gate (docs/bench.md)."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict
from pathlib import Path

from avatarrex.errors import check
from avatarrex.files.gate import check_writable, what_is
from avatarrex.files.json_text import write_json
from avatarrex.measure.bench.stages import STAGES, chosen, measure
from avatarrex.measure.plotting import require_matplotlib
from avatarrex.settings import DEVICE


def add_options(parser: argparse.ArgumentParser) -> None:
    """What to measure, of what, and where to."""
    add, file = parser.add_argument, "FILE.json"
    add("stages", nargs="*", metavar="stage", help=", ".join(STAGES) + " (all); or `bench ablation CAPTURE --out DIR`")
    add("--quick", action="store_true", help="two minutes in place of ten")
    add("--avatar", default="default", metavar="A", help="name, folder or .avatar file")
    add("--device", default="cpu", metavar="D", help="where the networks of frames run: cpu, cuda, mps, xpu … (cpu)")
    add("--capture", metavar="C", help="what `training` steps on; a small one is drawn unless given")
    add("--json", metavar=file, help="every figure")
    add("--plot", metavar="DIR", help="PNG plots of time against error; needs matplotlib")
    add(
        "--record",
        nargs="?",
        const="",
        metavar=file,
        help="write the baseline of this class of machine; other stages stay",
    )
    add("--gate", nargs="?", const="", metavar=file, help="exit status 1 where something is worse than the baseline")


def run(options: argparse.Namespace) -> int:
    """Measure, print, write what the options say; 1 where the gate fails. Raises `InputError` before any work."""
    stages = chosen(options.stages)
    _check(options)
    from avatarrex.fields.placement import device_named  # torch: wrong words are refused before it is loaded
    from avatarrex.measure.bench import gate, plots
    from avatarrex.measure.bench.report import Report
    from avatarrex.measure.bench.session import Bench

    capture = Path(options.capture) if options.capture else None
    device = str(device_named(options.device))
    bench = Bench(quick=options.quick, source=options.avatar, capture=capture, device=device)
    empty = Report.of([], {}, options.quick, device)
    if options.gate is not None:  # a baseline that is missing is reported now, not in ten minutes
        path = Path(options.gate or gate.baseline_path(empty))
        baseline = gate.read_baseline(path, empty)
    record = None if options.record is None else Path(options.record or gate.baseline_path(empty))
    recorded = Report.read(record) if record and record.is_file() else empty
    metrics = []
    for name in stages:
        began = time.monotonic()
        metrics += measure(name, bench)
        print(f"{name}: {STAGES[name]}, {time.monotonic() - began:.0f} s", file=sys.stderr)
    report = Report.of(metrics, bench.absent, options.quick, device)
    print(report.table())
    whole = report.over(recorded, stages) if recorded.mode == report.mode else report
    for out, what in ((options.json, report), (record, whole)):
        if out:
            write_json(Path(out), asdict(what))
            print(out)
    for out in plots.plot(metrics, Path(options.plot)) if options.plot else ():
        print(out)
    if options.gate is None:
        return 0
    verdicts = gate.compare(report, baseline, stages)
    print(gate.table(verdicts, path))
    return 0 if all(verdict.passed for verdict in verdicts) else 1


def _check(options: argparse.Namespace) -> None:
    """What would otherwise be noticed after the measurement."""
    for path in filter(None, (options.json, options.record)):
        check_writable(path)
    if options.plot:
        require_matplotlib()
        check(what_is(options.plot) in ("a folder", "nothing there"), "--plot", "", "a folder", what_is(options.plot))
    device = options.device
    check(DEVICE.fullmatch(device), "--device", "", "cpu, cuda, cuda:1, mps or xpu", device or "nothing")
    check(options.json != "", "--json", "", "a file", "nothing")
    if options.capture is not None:
        found = what_is(options.capture)
        check(found in ("a file", "a folder"), options.capture or "--capture", "", "a capture's folder or .zip", found)
