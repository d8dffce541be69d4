"""`avatarrex-studio VERB … --submit local|slurm`: the verb as a job of its own, or as many, one for each value. Needs no torch."""

from __future__ import annotations

import argparse
import fcntl
import itertools
import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from avatarrex_studio.cli import options
from avatarrex_studio.jobs.job_queue import GENERAL, JobQueue
from avatarrex_studio.jobs.submitted import Job, option_value

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable

LONG = ("train", "evaluate", "distil", "render", "sheet", "judge", "export", "capture", "bench", "stress")
"""Verbs that can be submitted."""
WHERE = ("local", "slurm")
NO_NAME = re.compile(r"[^\w.-]+")
"""What a folder's name has none of."""
ONE_PROCESS = ("nodes", "tasks_per_node", "ntasks_per_node", "ntasks")
"""Options that submitit would start the same job several times with."""


def wanted(words: Sequence[str]) -> bool:
    """Whether a command line is to run elsewhere."""
    return any(word == "--submit" or word.startswith("--submit=") for word in words)


def run(words: Sequence[str], check: Callable[[Sequence[str]], object]) -> int:
    """Submit a command line, once for each combination of what `--over` names; `check` refuses what no verb takes. Raises `InputError`."""
    given, rest = _parser().parse_known_args(list(words))
    options.one_of("--submit", given.submit, WHERE)
    if not rest or rest[0] not in LONG:
        raise InputError("--submit", "", "one of the verbs " + ", ".join(LONG), rest[0] if rest else "none")
    lines = [tuple(line) for line in expanded(rest, given.over)]
    for line in lines:
        check(line)
    if len(set(lines)) < len(lines):
        raise InputError("--over", "", "a command line of its own for each value", " ".join(given.over))
    at_once = options.whole("--at-once", given.at_once, 1)
    slurm = _slurm(given)
    folder = Path(given.jobs).absolute()
    check_writable(folder / "job")
    queue = JobQueue(given.submit, folder, slurm)
    folder.mkdir(parents=True, exist_ok=True)
    shared = Job("", (), os.getcwd(), given.submit, at_once, slurm)
    jobs = _new([replace(shared, words=line) for line in lines], folder)
    try:
        queue.submit(jobs)
    except InputError:
        for job in jobs:
            shutil.rmtree(job.path)
        raise
    for job in jobs:
        print(f"{job.path.name}: submitted; {job.log}")
    shown = folder.parent if folder.name == "jobs" else folder
    print(f"avatarrex-studio runs {os.path.relpath(shown)} --text   shows them")
    return 0


def expanded(words: Sequence[str], over: Sequence[str]) -> list[list[str]]:
    """The words with `{NAME}` replaced, for every combination of the values in `NAME=A,B,…`. Raises `InputError`."""
    names, values = [], []
    for text in over:
        name, equals, listed = text.partition("=")
        if not (re.fullmatch(r"\w+", name) and equals and all(listed.split(","))):
            raise InputError("--over", "", "NAME=VALUE,VALUE,…", text)
        if not any(f"{{{name}}}" in word for word in words):
            raise InputError("--over", name, f"{{{name}}} in the command line", " ".join(words))
        names.append(name)
        values.append(listed.split(","))
    lines = []
    for chosen in itertools.product(*values):
        line = list(words)
        for name, value in zip(names, chosen):
            line = [word.replace(f"{{{name}}}", value) for word in line]
        lines.append(line)
    return lines


def again(jobs: Sequence[Job], where: str) -> None:
    """Submit jobs once more that are at work nowhere, as they were submitted before. Raises `InputError`."""
    alike: dict[str, list[Job]] = {}
    for job in jobs:
        alike.setdefault(json.dumps([str(job.path.parent), job.slurm], sort_keys=True), []).append(job)
    for some in alike.values():
        queue = JobQueue(where, some[0].path.parent, some[0].slurm)
        try:
            queue.submit([job.written(state="queued", where=where, tries=0, code=None) for job in some])
        except InputError as error:
            for job in some:
                with open(job.log, "a", encoding="utf-8") as log:
                    log.write(f"{error}\n")
                job.written(state="failed", where=where)
            raise


def _new(jobs: Sequence[Job], folder: Path) -> list[Job]:
    """With folders of their own, numbered; one process at a time gives out numbers."""
    made = []
    with open(folder / ".numbers", "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        numbers = [int(found[0]) for path in folder.iterdir() if (found := re.match(r"\d+(?=-)", path.name))]
        for number, job in enumerate(jobs, 1 + max(numbers, default=0)):
            first = job.words[1] if len(job.words) > 1 else ""
            target = option_value(job.words, "--out") or option_value(job.words, "--json") or first
            name = "-".join(filter(None, (job.words[0], Path(target).stem)))
            path = folder / f"{number:04}-{NO_NAME.sub('_', name)[:60]}"
            path.mkdir()
            made.append(replace(job, folder=str(path)).written())
    return made


def _slurm(given: argparse.Namespace) -> dict[str, int | str]:
    """Options of SLURM by name, `timeout_min=600,partition=a`. Raises `InputError`."""
    if given.slurm and given.submit == "local":
        raise InputError("--slurm", "", "--submit slurm with it", "--submit local")
    found: dict[str, int | str] = {}
    for entry in given.slurm.split(",") if given.slurm else ():
        name, equals, value = entry.partition("=")
        if not (name and equals and value):
            raise InputError("--slurm", "", "NAME=VALUE,…", given.slurm)
        if name in ONE_PROCESS:
            raise InputError("--slurm", name, "nothing: a job is one process", value)
        if name in GENERAL and not value.isdecimal():
            raise InputError("--slurm", name, "a whole number", value)
        found[name] = int(value) if value.isdecimal() else value
    return found


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError("--submit", "", "its options with a value each", message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(add_help=False, allow_abbrev=False)
    add = parser.add_argument
    add("--submit", required=True)
    add("--over", action="append", default=[])
    add("--jobs", default="runs/jobs")
    add("--at-once", default=str(os.cpu_count() or 1))
    add("--slurm", default="")
    return parser
