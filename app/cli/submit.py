"""`avatarrex-studio VERB … --submit local|slurm`: the verb as a job of its own, or as many, one for each value. Needs no torch."""

from __future__ import annotations

import argparse
import itertools
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from avatarrex_studio.cli import options
from avatarrex_studio.jobs.submitted import Job, submit

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable

LONG = ("train", "evaluate", "distil", "render", "sheet", "judge", "export", "capture", "bench", "stress")
"""Verbs that can be submitted."""
WHERE = ("local", "slurm")
LOCAL_MINUTES, SLURM_MINUTES = 60 * 24 * 365, 60 * 24
"""Limits of time unless `--slurm timeout_min=…` says otherwise: none, and a day."""
SAVING_SECONDS = 120
"""Between the signal that a machine is taken away and its end: a training saves in it."""


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
    at_once = options.whole("--at-once", given.at_once, 1) if given.submit == "local" else 0
    folder = Path(given.jobs).absolute()
    check_writable(folder / "job")
    parameters = _parameters(given)
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [_new(folder, line, at_once) for line in lines]
    submit(jobs, given.submit, folder, parameters)
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


def again(job: Job, where: str) -> None:
    """Submit a job once more, which is at work nowhere. Raises `InputError`."""
    minutes = LOCAL_MINUTES if where == "local" else SLURM_MINUTES
    submit([job.written(state="queued", tries=0)], where, job.path.parent, {"timeout_min": minutes})


def _new(folder: Path, words: tuple[str, ...], at_once: int) -> Job:
    """A job with a folder of its own, numbered."""
    target = next((words[k + 1] for k, word in enumerate(words[:-1]) if word in ("--out", "--json")), words[1])
    name = re.sub(r"[^\w.-]+", "_", "-".join([words[0], Path(target).stem]))[:60]
    number = 1 + max((int(path.name[:4]) for path in folder.glob("[0-9][0-9][0-9][0-9]-*")), default=0)
    path = folder / f"{number:04}-{name}"
    path.mkdir()
    return Job(str(path), words, at_once).written()


def _parameters(given: argparse.Namespace) -> dict[str, Any]:
    """Of submitit's executor: `timeout_min=600,gpus_per_node=1`; `partition=a` is `slurm_partition`."""
    local = given.submit == "local"
    found: dict[str, Any] = {"timeout_min": LOCAL_MINUTES if local else SLURM_MINUTES}
    if not local:
        found["slurm_signal_delay_s"] = SAVING_SECONDS
    if given.slurm and local:
        raise InputError("--slurm", "", "--submit slurm with it", "--submit local")
    general = ("timeout_min", "nodes", "tasks_per_node", "cpus_per_task", "gpus_per_node", "mem_gb")
    for entry in given.slurm.split(",") if given.slurm else ():
        name, equals, value = entry.partition("=")
        if not (name and equals and value):
            raise InputError("--slurm", "", "NAME=VALUE,…", given.slurm)
        found[name if name in general else f"slurm_{name}"] = int(value) if value.isdecimal() else value
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
