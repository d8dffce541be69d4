"""Test figures of a release: trains each subject by `quick`, evaluates the avatar on test data beside the fitted meshes.

    python tools/release_figures.py WORK [--only NAMES] [--write]

WORK has person_f001.zip and person_m002.zip; `other` is made there. Steps whose files are there are not done again, a training that
was ended goes on. `--write` puts the figures into docs/figures/ and their tables into docs/results.md, between the marks of a subject.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from release_tables import Figures, tables, written

from avatarrex.avatar_file import load_avatar
from avatarrex.files.json_text import read_json, write_json
from avatarrex.measure.bench.report import cpu

ROOT = Path(__file__).parents[1]
PAGE, KEPT = ROOT / "docs" / "results.md", ROOT / "docs" / "figures"
STUDIO, MEASURE = "avatarrex-studio", "python -m avatarrex.measure"


@dataclass(frozen=True)
class Subject:
    """A capture of WORK, and options of what is done with it."""

    capture: str
    training: str
    body: str
    face: str
    face_alone: str
    made: str = ""
    """Options of `capture make`; empty where a file of the user's is there."""
    regions: str | None = None
    """Options of `measure face-regions`."""


WITHOUT = "--held-out-views 7,8,9"
SUBJECTS = {
    "person_f001": Subject("person_f001.zip", f"--held-out-frames 48:60 {WITHOUT}", "", "", "--frames 48:60:3"),
    "person_m002": Subject("person_m002.zip", f"--held-out-frames 16:20 {WITHOUT}", "", "", "--frames held-out"),
    "other": Subject(
        "other", "", "--views 0,4,8,11",
        "--exposed-as body --frames 24:32:2,64:72:2", "--exposed-as body --frames 24:32:4,64:72:4",
        made="--size small --subject other --conditions all", regions="--exposed-as body",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Step:
    """A command in WORK, done when its file is there."""

    command: str
    file: str

    def run(self, work: Path) -> None:
        """Raises `CalledProcessError`."""
        if not (work / self.file).exists():
            print(self.command, flush=True)
            program = [sys.executable, "-c", "from avatarrex_studio.cli.main import main; raise SystemExit(main())"]
            tool = [sys.executable, "-m", "avatarrex.measure"]
            words = self.command.removeprefix(STUDIO).removeprefix(MEASURE).split()
            subprocess.run([*(program if self.command.startswith(STUDIO) else tool), *words], cwd=work, check=True)


def evaluations(name: str, subject: Subject) -> dict[str, Step]:
    """By what they are of."""
    options = {
        "body": f"--frames held-out {subject.body}",
        "face": f"--rig face {subject.face or '--frames held-out'}",
        "face_alone": f"--rig face --face-only {subject.face_alone}",
    }
    evaluate = f"{STUDIO} evaluate {name}.avatar {subject.capture} --baselines"
    found = {
        part: Step(f"{evaluate} {words.strip()} --json {name}_{part}.json", f"{name}_{part}.json")
        for part, words in options.items()
    }
    if subject.regions is not None:
        file = f"{name}_regions.json"
        regions = f"{MEASURE} face-regions {name}.avatar {subject.capture} {subject.regions} --json {file}"
        found["regions"] = Step(regions, file)
    return found


def trained(name: str, subject: Subject, work: Path) -> list[Step]:
    """Make the capture, train; the avatar of the last checkpoint is WORK/NAME.avatar then."""
    run = work / "runs" / name
    steps = [Step(f"{STUDIO} capture make {subject.capture} {subject.made}", subject.capture)] if subject.made else []
    words = " ".join(f"--recipe quick {subject.training} --no-surface --out runs/{name}".split())
    begun = " --resume" if run.exists() else ""
    steps.append(Step(f"{STUDIO} train {subject.capture} {words}{begun}", f"{name}.avatar"))
    commit = work / f"{name}.commit"
    if not commit.exists():
        commit.write_text(head())
    for step in steps:
        step.run(work)
    if not (work / f"{name}.avatar").exists():
        last = max((run / "checkpoints").iterdir())
        shutil.copyfile(last / "avatar.avatar", work / f"{name}.avatar")
    return [*steps[:-1], Step(steps[-1].command.removesuffix(begun), f"{name}.avatar")]


def head() -> str:
    """The commit that is checked out."""
    found = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return found.stdout.strip()


def figures(name: str, subject: Subject, work: Path) -> Figures:
    """What every command of a subject found."""
    steps, tests = trained(name, subject, work), evaluations(name, subject)
    for step in tests.values():
        step.run(work)
    found = {part: read_json(work / step.file) for part, step in tests.items()}
    training = load_avatar(work / f"{name}.avatar").meta["training"]
    return {
        "format": 1,
        "trained_by": (work / f"{name}.commit").read_text().strip(),
        "seed": training["seed"],
        "training_minutes": round(training["seconds"] / 60),
        "machine": f"{cpu()}, one thread",
        "date": str(date.fromtimestamp((work / f"{name}.avatar").stat().st_mtime)),
        "splits": training["splits"],
        "commands": [step.command for step in (*steps, *tests.values())],
        "test": {part: {key: one[key] for key in ("splits", "surface")} for part, one in found.items() if part != "regions"},
        "regions": found.get("regions"),
    }  # fmt: skip


def main() -> None:
    """Run what is not done; print the tables or write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--only", default=",".join(SUBJECTS), metavar="NAMES")
    parser.add_argument("--write", action="store_true", help="into docs/figures/ and docs/results.md")
    options = parser.parse_args()
    for name in options.only.split(","):
        found = figures(name, SUBJECTS[name], options.work)
        if options.write:
            KEPT.mkdir(exist_ok=True)
            write_json(KEPT / f"{name}.json", found)
            PAGE.write_text(written(PAGE.read_text(), name, tables(found)))
        else:
            print(tables(found))


if __name__ == "__main__":
    main()
