"""Where jobs wait: they are given to submitit, on this machine or to SLURM, and one that nobody has any more is dead.

JOBS/0001-train-a/queued.json     its number in the queue, and the machine that gave it there
"""

from __future__ import annotations

import functools
import socket
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.submitted import SAVING_SECONDS, Job
from avatarrex_studio.jobs.training_process import last_words

from avatarrex.errors import InputError, plain
from avatarrex.files.gate import what_is
from avatarrex.training.runs.control import Heartbeat, read_json, write_json

LOCAL_MINUTES, SLURM_MINUTES = 60 * 24 * 365, 60 * 24
"""Limits of time unless `--slurm timeout_min=…` says otherwise: none, and a day."""
GENERAL = ("timeout_min", "cpus_per_task", "gpus_per_node", "mem_gb")
"""Options that submitit has for every queue; any other is SLURM's own."""
REFUSALS = (RuntimeError, ValueError, TypeError, NameError, OSError, AssertionError)
"""What submitit raises for wrong parameters, and for a queue that does not take a job."""
GONE = (
    "BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY", "PREEMPTED", "TIMEOUT",
)  # fmt: skip
"""Last states of a job of SLURM's that does not start it again (`sacct`, JOB STATE CODES)."""
LOOK_SECONDS = 30.0
"""Between two looks at SLURM's states."""


class JobQueue:
    """Of this machine or of SLURM."""

    def __init__(self, where: str, folder: Path, slurm: Mapping[str, int | str]) -> None:
        """With files in `folder`/submitit; before any job has a folder. Raises `InputError` where there is no such queue."""
        try:
            from submitit import AutoExecutor
        except ImportError:
            extra = "the 'cluster' extra: pip install 'avatarrex-studio[cluster]'"
            raise InputError("--submit", "", extra, "no submitit") from None
        self.where = where
        try:
            self._executor = AutoExecutor(folder / "submitit", cluster=where)
            self._executor.update_parameters(name="avatarrex", **parameters(where, slurm))
        except REFUSALS as error:
            raise self._refusal(error) from None

    def submit(self, jobs: Sequence[Job]) -> None:
        """On SLURM as one array. Raises `InputError`."""
        for job in jobs:
            (job.path / "queued.json").unlink(missing_ok=True)
        try:
            with self._executor.batch():
                entries = [self._executor.submit(job) for job in jobs]
        except REFUSALS as error:
            raise self._refusal(error) from None
        for job, entry in zip(jobs, entries):
            write_json(job.path / "queued.json", {"number": str(entry.job_id), "host": socket.gethostname()})

    def _refusal(self, error: Exception) -> InputError:
        found = (str(error) or type(error).__name__).splitlines()[0]
        return InputError("--submit", self.where, "a queue that takes jobs", found)


def parameters(where: str, slurm: Mapping[str, int | str]) -> dict[str, Any]:
    """Of submitit's executor: `timeout_min` stays, `partition` is `slurm_partition`; on this machine SLURM's are left out."""
    if where == "local":
        return {"timeout_min": LOCAL_MINUTES}
    named = {name if name in GENERAL else f"slurm_{name}": value for name, value in slurm.items()}
    return {"timeout_min": SLURM_MINUTES, "slurm_signal_delay_s": int(SAVING_SECONDS), **named}


def jobs_below(folder: Path) -> list[Path]:
    """Folders of jobs: `folder` itself, those in it, and those of a `jobs` folder in or below it, by name."""
    found = {file.parent for pattern in ("job.json", "*/job.json", "jobs/*/job.json", "*/jobs/*/job.json")
             for file in folder.glob(pattern) if what_is(file) == "a file"}  # fmt: skip
    return sorted(found)


def dead(job: Job) -> bool:
    """Whether it is at work or queued by its own word, its heart does not beat, and no queue has it."""
    beat = Heartbeat.read(job.path)
    if job.state not in ("queued", "running") or (beat is not None and beat.alive()):
        return False
    known = listed(job)
    return not known if known is not None else job.state == "running" and beat is not None


def listed(job: Job) -> bool | None:
    """Whether the queue has the job, waiting or at work; None where that cannot be known from here."""
    entry = read_json(job.path / "queued.json") or {}
    number, host = str(entry.get("number", "")), entry.get("host")
    if job.where == "slurm":
        return _listed_by_slurm(number) if number else None
    if not number.isdecimal() or host != socket.gethostname() or not Path("/proc").is_dir():
        return None
    try:  # the number is that of submitit's process, or by now that of another program
        return b"submitit" in Path("/proc", number, "cmdline").read_bytes()
    except OSError:
        return False


def _listed_by_slurm(number: str) -> bool | None:
    whole_array = number.split("_")[0]
    state = _states(whole_array, int(time.monotonic() // LOOK_SECONDS)).get(number)
    return None if state is None else state not in GONE


@functools.lru_cache(maxsize=256)
def _states(number: str, look: int) -> dict[str, str]:
    """By the number of a job or of one in its array; none where SLURM does not tell. `look` counts the looks."""
    from submitit import SlurmJob

    command = ["sacct", "-o", "JobID,State", "--parsable2", "-j", number]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=LOOK_SECONDS).stdout
    except (OSError, subprocess.SubprocessError):
        return {}
    rows = SlurmJob.watcher.read_info(said)
    return {name: row["State"].partition(" ")[0] for name, row in rows.items()}  # also `CANCELLED by 1000`


def view_of(job: Job, name: str) -> RunView:
    """As a row of the table of runs; a failure names its log and the last line in it."""
    state = "dead" if dead(job) else job.state
    note = ""
    if state in ("failed", "dead"):
        said = last_words(job.log) or ("no output" if job.code is None else f"exit code {job.code}")
        note = plain(f"{job.log}: {said}")
    elif job.tries > 1:
        note = f"begun {job.tries} times"
    return RunView(job.path, name, state, note, part=plain(job.words[0]))
