"""Many hostile inputs through every stage, a table of what was found, and failures as small files (docs/stress.md).

Exit status 0 where every check passed, 1 where one failed, 130 after Ctrl+C (with what was found so far).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from avatarrex.errors import check
from avatarrex.files.gate import check_writable, read_text, what_is
from avatarrex.files.json_text import write_json

if TYPE_CHECKING:
    from avatarrex.measure.stress.findings import Finding
    from avatarrex.measure.stress.run import Outcome

MOST_CASES = 10_000_000
MOST_SHRUNK = 5
"""Failures that are shrunk, each of another check; the others are in the table."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many cases, and where the failures go."""
    add = parser.add_argument
    add("--n", default="10000", metavar="N", help="driving signals (10000); one in twenty becomes a whole frame")
    add("--seed", default="0", metavar="S", help="of all cases (0)")
    add("--json", metavar="FILE.json", help="the table")
    add("--out", default="stress", metavar="DIR", help="a folder for failures, made when there are some (stress)")
    add("--processes", metavar="P", help="how many at a time (one for each core)")
    add("--replay", metavar="FILE", help="run one failure again, and nothing else")


def run(options: argparse.Namespace) -> int:
    """Search, or replay a failure; returns the exit status. Raises `InputError` before any work."""
    if options.replay is not None:
        return _replay(options.replay)
    count, seed = _number("--n", options.n, 1, MOST_CASES), _number("--seed", options.seed, 0, 2**63 - 1)
    processes = None if options.processes is None else _number("--processes", options.processes, 1, 256)
    if options.json is not None:
        check_writable(options.json)
    check(what_is(options.out) in ("a folder", "nothing there"), "--out", "", "a folder", what_is(options.out))
    check_writable(Path(options.out) / "failure.json")
    return _search(count, seed, processes, options.json, Path(options.out))


def _search(count: int, seed: int, processes: int | None, json_path: str | None, out: Path) -> int:
    from tqdm import tqdm

    from avatarrex.measure.bench.report import cores
    from avatarrex.measure.stress import run as stress
    from avatarrex.measure.stress.findings import Tally

    tally, interrupted = Tally(), False
    failed: list[Outcome] = []
    cases = stress.plan(count)
    outcomes = stress.run(cases, seed, processes or cores())
    try:
        for outcome in tqdm(outcomes, total=len(cases), unit="case", disable=None):
            tally.add(outcome.kind, outcome.number, outcome.findings, outcome.cpu_seconds)
            if outcome.failures:
                failed.append(outcome)
            for finding in outcome.failures:  # at once: a long run may be killed
                line = f"{outcome.kind} {outcome.number}: {finding.check}: {finding.figure:.3g} {finding.note}"
                tqdm.write(line.rstrip())
    except KeyboardInterrupt:
        interrupted = True
        outcomes.close()
    print(tally.text())
    files = [] if interrupted else _write(failed, seed, out)
    done = sum(tally.cases.values())
    if json_path is not None:
        about = {"n": count, "seed": seed, "interrupted": interrupted}
        write_json(json_path, {**about, **tally.to_json(), "files": files})
    state = f"interrupted after {done} of {len(cases)} cases" if interrupted else f"{done} cases"
    print(f"{state}, seed {seed}: " + (f"{tally.failures} checks failed" if tally.failures else "every check passed"))
    return 130 if interrupted else int(tally.failures > 0)


def _write(failed: list[Outcome], seed: int, out: Path) -> list[str]:
    """Shrink the first failure of each check, and write it; the files' names."""
    from avatarrex.measure.stress.case import to_json
    from avatarrex.measure.stress.run import KINDS, make
    from avatarrex.measure.stress.shrink import shrink

    first: dict[tuple[str, str], tuple[Outcome, Finding]] = {}
    for outcome in failed:
        for finding in outcome.failures:
            first.setdefault((outcome.kind, finding.check), (outcome, finding))
    files: list[str] = []
    for outcome, finding in list(first.values())[:MOST_SHRUNK]:
        kind = KINDS[outcome.kind]
        small = shrink(kind, make(outcome.kind, outcome.number, seed), finding)
        path = out / f"{outcome.kind}_{seed}_{outcome.number}_{len(files)}.json"
        write_json(path, to_json(kind, small.inputs, small.finding))
        files.append(str(path))
        print(f"{outcome.kind} {outcome.number}: {finding.check}")
        print(f"  shrunk in {small.tried} tries; avatarrex-studio stress --replay {path}")
    return files


def _replay(path: str) -> int:
    """Examine the case of a file: 1 where the check that the file names fails still, 0 where it holds now."""
    text = read_text(path, "a failure written by stress")
    from avatarrex.measure.stress.case import examine, from_json
    from avatarrex.measure.stress.findings import Tally
    from avatarrex.measure.stress.run import KINDS

    kind, inputs, check = from_json(text, KINDS, path)
    findings = examine(kind, inputs, repeated=True)
    tally = Tally()
    tally.add(kind.name, 0, findings, 0.0)
    print(tally.text().split("\n\n")[0])
    failed = [finding for finding in findings if finding.failed]
    for finding in failed:
        if finding.note:
            print(f"{finding.check}: {finding.note}")
    print(f"{check}: " + ("fails" if any(finding.check == check for finding in failed) else "holds"))
    return int(bool(failed))


def _number(option: str, text: str, low: int, high: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    check(low <= value <= high, option, "", f"an integer from {low} to {high}", text or "nothing")
    return value
