"""Test figures of a release: trains each subject by `quick`, evaluates the avatar on test data beside the fitted meshes.

    python tools/release_figures.py WORK [--only NAMES] [--write]

WORK has person_f001.zip and person_m002.zip; `other` and `loose` are made there. Commands that were done are not done again, a capture
or a training that was ended goes on. `--write` puts the figures into docs/figures/ and their tables into docs/results.md, between the
marks of a subject.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from release_tables import Figures, tables, written

import avatarrex
from avatarrex.avatar_file import load_avatar
from avatarrex.files.json_text import read_json, write_json
from avatarrex.measure.bench.report import cpu

ROOT = Path(__file__).parents[1]
PAGE, KEPT = ROOT / "docs" / "results.md", ROOT / "docs" / "figures"
STUDIO = "from avatarrex_studio.cli.main import main; raise SystemExit(main())"
PROGRAMS = {"avatarrex-studio": [sys.executable, "-c", STUDIO], "python": [sys.executable]}
LAST = "step_00004800"
"""The last checkpoint of `quick`."""
WITHOUT = "--held-out-views 7,8,9"


@dataclass(frozen=True)
class Subject:
    """A capture of WORK, and options of what is done with it."""

    capture: str
    training: str = ""
    body: str = ""
    face: str = "--frames held-out"
    face_alone: str = "--frames held-out"
    made: str = ""
    """Options of `capture make`; empty where the capture is a file."""
    regions: str | None = None
    """Options of `measure face-regions`."""


SUBJECTS = {
    "person_f001": Subject("person_f001.zip", f"--held-out-frames 48:60 {WITHOUT}", face_alone="--frames 48:60:3"),
    "person_m002": Subject("person_m002.zip", f"--held-out-frames 16:20 {WITHOUT}"),
    "other": Subject(
        "other",
        body="--views 0,4,8,11",
        face="--exposed-as body --frames 24:32:2,64:72:2",
        face_alone="--exposed-as body --frames 24:32:4,64:72:4",
        made="--size small --subject other --conditions all",
        regions="--exposed-as body",
    ),
    "loose": Subject(
        "loose",
        face="--frames 24:32:2,64:72:2",
        face_alone="--frames 24:32:4,64:72:4",
        made="--size small --garment loose --seed 0",
    ),
}


@dataclass(frozen=True)
class Step:
    """A command in WORK, and the file or folder that it makes."""

    command: str
    file: str

    def run(self, work: Path, more: str = "") -> None:
        """One thread, with options that go on with what was ended; not where the same command ended before. Raises
        `CalledProcessError`."""
        done = work / f".{self.file.replace('/', '_')}.done"
        if done.exists() and (work / self.file).exists() and done.read_text() == self.command:
            return
        print(self.command, more, flush=True)
        first, *words = shlex.split(f"{self.command} {more}")
        program = PROGRAMS.get(first, [first])
        subprocess.run([*program, *words], cwd=work, check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        done.write_text(self.command)


def training(name: str, subject: Subject) -> dict[str, Step]:
    """By what they are: the capture, the run, the avatar."""
    words = " ".join(f"{subject.capture} --recipe quick {subject.training} --no-surface --out runs/{name}".split())
    steps = {"run": Step(f"avatarrex-studio train {words}", f"runs/{name}")}
    steps["avatar"] = Step(f"cp runs/{name}/checkpoints/{LAST}/avatar.avatar {name}.avatar", f"{name}.avatar")
    if not subject.made:
        return steps
    return {
        "capture": Step(f"avatarrex-studio capture make {subject.capture} {subject.made}", subject.capture),
        **steps,
    }


def evaluations(name: str, subject: Subject) -> dict[str, Step]:
    """By what they are of."""
    options = {
        "body": f"--frames held-out {subject.body}",
        "face": f"--rig face {subject.face}",
        "face_alone": f"--rig face --face-only {subject.face_alone}",
    }
    evaluate = f"avatarrex-studio evaluate {name}.avatar {subject.capture} --baselines"
    found = {
        part: Step(f"{evaluate} {words.strip()} --json {name}_{part}.json", f"{name}_{part}.json")
        for part, words in options.items()
    }
    if subject.regions is not None:
        file = f"{name}_regions.json"
        regions = f"python -m avatarrex.measure face-regions {name}.avatar {subject.capture} {subject.regions}"
        found["regions"] = Step(f"{regions} --json {file}", file)
    return found


def train(name: str, subject: Subject, work: Path) -> None:
    """Make WORK/NAME.avatar. A training that begins anew deletes the avatar before and its figures."""
    steps, run = training(name, subject), work / "runs" / name
    begun = (run / "run.json").exists()
    if not begun:
        write_json(work / f"{name}_training.json", {"commit": head(), "machine": cpu()})
        for step in (steps["avatar"], *evaluations(name, subject).values()):
            (work / step.file).unlink(missing_ok=True)
    for kind, step in steps.items():
        step.run(work, "--resume" if kind == "run" and begun else "")


def head() -> str:
    """The commit of the program that runs. Raises `SystemExit` where that is not of this checkout."""
    if ROOT not in Path(avatarrex.__file__).parents:
        raise SystemExit(f"release_figures: expected avatarrex of {ROOT}, found {avatarrex.__file__}")
    commit, changed = (
        subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
        for words in (("rev-parse", "--short=8", "HEAD"), ("status", "--porcelain"))
    )
    return commit + ("-dirty" if changed else "")


def figures(name: str, subject: Subject, work: Path) -> Figures:
    """What every command of a subject found."""
    train(name, subject, work)
    tests = evaluations(name, subject)
    for step in tests.values():
        step.run(work)
    found = {part: read_json(work / step.file) for part, step in tests.items()}
    begun, avatar = read_json(work / f"{name}_training.json"), work / f"{name}.avatar"
    meta = load_avatar(avatar).meta["training"]
    steps = (*training(name, subject).values(), *tests.values())
    return {
        "format": 1,
        "trained_by": begun["commit"],
        "seed": meta["seed"],
        "training_minutes": round(meta["seconds"] / 60),
        "machine": f"{begun['machine']}, one thread",
        "date": str(date.fromtimestamp(avatar.stat().st_mtime)),
        "capture_key": meta["capture_key"],
        "splits": meta["splits"],
        "commands": [step.command for step in steps],
        "test": {part: {key: found[part][key] for key in ("splits", "surface")} for part in tests if part != "regions"},
        "regions": found.get("regions"),
    }


def main() -> None:
    """Run what is not done; print the tables or write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--only", default=",".join(SUBJECTS), metavar="NAMES")
    parser.add_argument("--write", action="store_true", help="into docs/figures/ and docs/results.md")
    options = parser.parse_args()
    names = options.only.split(",")
    for name in names:
        if name not in SUBJECTS:
            parser.error(f"--only: expected {', '.join(SUBJECTS)}, found {name}")
        if not SUBJECTS[name].made and not (options.work / SUBJECTS[name].capture).exists():
            parser.error(f"WORK: {SUBJECTS[name].capture} is not there")
    for name in names:
        found = figures(name, SUBJECTS[name], options.work)
        if not options.write:
            print(tables(found))
            continue
        page = written(PAGE.read_text(encoding="utf-8"), name, tables(found))
        KEPT.mkdir(exist_ok=True)
        write_json(KEPT / f"{name}.json", found)
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
