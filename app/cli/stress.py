"""`avatarrex-studio stress`: many hostile inputs through every stage, a table of what was found, and failures as small files.

Exit status 0 where every check held, 1 where one failed, 130 after Ctrl+C (with what was found so far).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, read_text, what_is, write_text

if TYPE_CHECKING:
    from avatarrex.measure.stress.run import Outcome

MOST = 10_000_000
SHRUNK = 5
"""Failures that are shrunk, each of another check; the others are in the table."""


def add_options(stress: argparse.ArgumentParser) -> None:
    """The options of the verb."""
    add = stress.add_argument
    add("--n", default="10000", metavar="N", help="driving signals (10000); one in twenty becomes a whole frame")
    add("--seed", default="0", metavar="S", help="of all cases (0)")
    add("--json", metavar="FILE.json", help="the table")
    add("--out", default="stress", metavar="DIR", help="a folder for failures, made when there are some (stress)")
    add("--processes", metavar="P", help="how many at a time (one for each core)")
    add("--replay", metavar="FILE", help="run one failure again, and nothing else")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb; returns the exit code."""
    if arguments.replay is not None:
        return _replay(arguments.replay)
    count, seed = _number("--n", arguments.n, 1, MOST), _number("--seed", arguments.seed, 0, 2**63 - 1)
    processes = None if arguments.processes is None else _number("--processes", arguments.processes, 1, 256)
    if arguments.json is not None:
        check_writable(arguments.json)
    if what_is(arguments.out) not in ("a folder", "nothing there"):
        raise InputError("--out", "", "a folder", what_is(arguments.out))
    check_writable(Path(arguments.out) / "failure.json")
    from avatarrex.measure.bench.device import cores

    return _run(count, seed, processes or cores(), arguments.json, Path(arguments.out))


def _run(count: int, seed: int, processes: int, json_path: str | None, out: Path) -> int:
    from tqdm import tqdm

    from avatarrex.measure.stress import run as stress
    from avatarrex.measure.stress.tally import Tally

    tally, interrupted = Tally(), False
    failed: list[Outcome] = []
    cases = stress.plan(count)
    outcomes = stress.run(cases, seed, processes)
    try:
        for outcome in tqdm(outcomes, total=len(cases), unit="case", disable=None):
            tally.add(outcome.kind, outcome.number, outcome.findings, outcome.cpu_seconds)
            wrong = [finding for finding in outcome.findings if finding.failed]
            if wrong:
                failed.append(outcome)
            for finding in wrong:  # at once: a long run may be killed
                tqdm.write(
                    f"{outcome.kind} {outcome.number}: {finding.check}: {finding.figure:.3g} {finding.note}".rstrip()
                )
    except KeyboardInterrupt:
        interrupted = True
        outcomes.close()
    print(tally.text())
    files = [] if interrupted else _write(failed, seed, out)
    done = sum(tally.cases.values())
    if json_path is not None:
        report = {"n": count, "seed": seed, "interrupted": interrupted, **tally.to_json(), "files": files}
        write_text(json_path, json.dumps(report, indent=1) + "\n")
    state = f"interrupted after {done} of {len(cases)} cases" if interrupted else f"{done} cases"
    print(f"{state}, seed {seed}: " + (f"{tally.failures} checks failed" if tally.failures else "every check held"))
    return 130 if interrupted else int(tally.failures > 0)


def _write(failed: list[Outcome], seed: int, out: Path) -> list[str]:
    """Shrink the first failure of each check, and write it; the files' names."""
    from avatarrex.measure.stress.case import to_json
    from avatarrex.measure.stress.run import KINDS, make
    from avatarrex.measure.stress.shrink import shrink

    files: dict[tuple[str, str], str] = {}
    for outcome in failed:
        for finding in outcome.findings:
            key = outcome.kind, finding.check
            if not finding.failed or key in files or len(files) == SHRUNK:
                continue
            kind = KINDS[outcome.kind]
            small = shrink(kind, make(outcome.kind, outcome.number, seed), finding)
            path = out / f"{outcome.kind}_{seed}_{outcome.number}_{len(files)}.json"
            write_text(path, json.dumps(to_json(kind, small.inputs, small.finding), indent=1) + "\n")
            files[key] = str(path)
            print(f"{outcome.kind} {outcome.number}: {finding.check}")
            print(f"  shrunk in {small.tried} tries; avatarrex-studio stress --replay {path}")
    return list(files.values())


def _replay(path: str) -> int:
    """Examine the case of a file: 1 where the check that the file names fails still, 0 where it holds now."""
    text = read_text(path, "a failure written by stress")
    from avatarrex.measure.stress.case import examine, from_json
    from avatarrex.measure.stress.run import KINDS
    from avatarrex.measure.stress.tally import Tally

    kind, inputs, check = from_json(text, KINDS, path)
    findings = examine(kind, inputs, repeated=True)
    tally = Tally()
    tally.add(kind.name, 0, findings, 0.0)
    print(tally.text().split("\n\n")[0])
    notes = [f"{finding.check}: {finding.note}" for finding in findings if finding.failed and finding.note]
    print(
        "\n".join(
            [*notes, f"{check}: " + ("fails" if any(f.failed and f.check == check for f in findings) else "holds")]
        )
    )
    return int(any(finding.failed for finding in findings))


def _number(option: str, text: str, low: int, high: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise InputError(option, "", f"an integer from {low} to {high}", text or "nothing")
    return value
