"""`avatarrex-studio bench [stage…]`: run time against error, here and now (docs/bench.md).

Options are declared and checked without loading torch.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from avatarrex_studio.cli.options import add_device

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, what_is, write_text
from avatarrex.measure.bench.stages import STAGES, chosen


def add_options(bench: argparse.ArgumentParser) -> None:
    """The options of the measuring stages."""
    add = bench.add_argument
    add("stages", nargs="*", metavar="stage", help=", ".join(STAGES) + " (all); or `bench ablation CAPTURE --out DIR`")
    add("--quick", action="store_true", help="two minutes in place of ten")
    add("--avatar", default="default", metavar="A", help="name, folder or .avatar file")
    add("--capture", metavar="C", help="what `training` steps on; a small one is drawn unless given")
    add("--json", metavar="FILE.json", help="every figure")
    add("--plot", metavar="DIR", help="PNG plots of time against error; needs matplotlib")
    add("--record", nargs="?", const="", metavar="FILE.json", help="write the baseline of this class of machine")
    add(
        "--gate",
        nargs="?",
        const="",
        metavar="FILE.json",
        help="exit status 1 where something is worse than the baseline",
    )
    add_device(bench)


def run(arguments: argparse.Namespace) -> int:
    """Measure, print the table, write what was asked for; 1 where the gate fails. Raises `InputError` before any work."""
    stages = chosen(arguments.stages)
    _check(arguments)
    from avatarrex.fields.placement import device_named
    from avatarrex.measure.bench import gate, plots
    from avatarrex.measure.bench.report import Report
    from avatarrex.measure.bench.session import Bench
    from avatarrex.measure.bench.stages import measure

    capture = Path(arguments.capture) if arguments.capture else None
    device = str(device_named(arguments.device))
    bench = Bench(quick=arguments.quick, source=arguments.avatar, capture=capture, device=device)
    if arguments.gate is not None:  # a baseline that is missing is said now, not in ten minutes
        empty = Report.of([], {}, arguments.quick, device)
        path = Path(arguments.gate or gate.baseline_path(empty))
        baseline = gate.read_baseline(path, empty)
    metrics = []
    for name in stages:
        began = time.monotonic()
        metrics += measure(name, bench)
        print(f"{name}: {STAGES[name]}, {time.monotonic() - began:.0f} s", file=sys.stderr)
    report = Report.of(metrics, bench.absent, arguments.quick, device)
    print(report.table())
    written = [Path(arguments.json)] if arguments.json else []
    if arguments.record is not None:
        written.append(Path(arguments.record or gate.baseline_path(report)))
    for out in written:
        write_text(out, json.dumps(report.to_json(), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
        print(out)
    if arguments.plot:
        for out in plots.plot(metrics, Path(arguments.plot)):
            print(out)
    if arguments.gate is None:
        return 0
    verdicts = gate.compare(report, baseline, stages)
    print(gate.table(verdicts, path))
    return 0 if all(verdict.passed for verdict in verdicts) else 1


def _check(arguments: argparse.Namespace) -> None:
    """What would otherwise be noticed after the measurement."""
    for option in ("json", "record"):
        given = getattr(arguments, option)
        if given:
            check_writable(given)
    if arguments.plot and find_spec("matplotlib") is None:
        raise InputError("--plot", "", "matplotlib: pip install 'avatarrex-studio[bench]'", "none")
    if arguments.plot and what_is(arguments.plot) not in ("a folder", "nothing there"):
        raise InputError("--plot", "", "a folder", what_is(arguments.plot))
    if arguments.json == "":
        raise InputError("--json", "", "a file", "nothing")
    if arguments.capture is not None and what_is(arguments.capture) not in ("a file", "a folder"):
        raise InputError(arguments.capture or "--capture", "", "a capture's folder or .zip", what_is(arguments.capture))
