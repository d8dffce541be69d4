"""A verb of the command line that runs elsewhere: what its job's folder says, and the function that does it there.

    JOBS/0001-train-a/job.json        words, state, tries, exit code
                      heartbeat.json  that it lives, as in a run folder
                      log             what the verb prints

submitit calls the function in a process of its own on this machine, or on one of a SLURM cluster; the verb runs in a child
of that. A child that is killed begins again, up to `TRIES` times: a training goes on from its last checkpoint.
"""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.training_process import COMMAND, last_words

from avatarrex.errors import InputError, plain
from avatarrex.files.gate import what_is
from avatarrex.training.runs.control import Heart, Heartbeat, read_json, write_json

FORMAT = 1
TRIES = 5
"""Beginnings of a verb that is killed."""
SECONDS = 1.0
"""Between two looks at a child, or for a free place."""
STOPPED = 130
STATES = ("queued", "running", "finished", "stopped", "failed")


@dataclass(frozen=True)
class Job:
    """One command line, and its folder."""

    folder: str
    words: tuple[str, ...]
    at_once: int = 0
    """Jobs of the folder's neighbours that run at a time on this machine; 0: all."""
    tries: int = 0
    state: str = "queued"
    code: int | None = None
    """Exit code; of a child that was killed the signal, negative."""
    format: int = FORMAT

    @property
    def path(self) -> Path:
        """Its folder."""
        return Path(self.folder)

    @property
    def log(self) -> Path:
        """What its verb prints."""
        return self.path / "log"

    @property
    def run(self) -> Path | None:
        """The run folder of a training."""
        return Path(_value(self.words, "--out")) if self.words[0] == "train" else None

    @classmethod
    def read(cls, path: Path) -> Job | None:
        """The job in a folder; None where there is none that can be read."""
        data = read_json(path / "job.json")
        if data is None or data.get("format") != FORMAT or data.get("state") not in STATES:
            return None
        words = data.get("words")
        if not isinstance(words, list) or not words or not all(isinstance(word, str) for word in words):
            return None
        numbers = {name: data[name] for name in ("at_once", "tries", "code") if isinstance(data.get(name), int)}
        return cls(str(path), tuple(words), state=data["state"], **numbers)

    def written(self, **changes: Any) -> Job:
        """With changes, as its folder has them. Raises `InputError`."""
        changed = replace(self, **changes)
        write_json(self.path / "job.json", {**asdict(changed), "words": list(changed.words)}, lasting=True)
        return changed

    def __call__(self) -> int:
        """Run the verb to its end, and again where it is killed; its exit code. What submitit calls."""
        heart = Heart(self.path, lambda: Heartbeat(time.time(), os.getpid(), socket.gethostname()))
        heart.beat()
        heart.start()
        try:
            with place(self.path.parent, self.at_once):
                return self._repeated()
        finally:
            heart.stop()

    def checkpoint(self) -> Any:
        """What submitit queues again when SLURM takes the machine away: this job; its verb has saved before."""
        from submitit.helpers import DelayedSubmission

        child = _CHILDREN.get(self.folder)
        if child is not None:
            child.send_signal(signal.SIGINT)
            child.wait()
        return DelayedSubmission(self.written(state="queued"))

    def _repeated(self) -> int:
        job = self
        while True:
            job = job.written(state="running", tries=job.tries + 1, code=None)
            code = job._once()
            if code >= 0 or job.tries >= TRIES:
                break
        state = {0: "finished", STOPPED: "stopped"}.get(code, "failed")
        job.written(state=state, code=code)
        return code

    def _once(self) -> int:
        words = [*self.words]
        if self.run and "--resume" not in words and (self.run / "run.json").exists():
            words.append("--resume")
        with open(self.log, "ab") as output:
            child = subprocess.Popen(
                [*COMMAND, *words], stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
            )
            _CHILDREN[self.folder] = child
            try:
                return child.wait()
            finally:
                del _CHILDREN[self.folder]


_CHILDREN: dict[str, subprocess.Popen[bytes]] = {}
"""By the job's folder: what `checkpoint`, which submitit calls in a handler of signals, has to stop."""


@contextmanager
def place(folder: Path, count: int) -> Iterator[None]:
    """One of `count` places among the processes of this machine, waited for; a process that is killed gives its own back."""
    if not count:
        yield
        return
    while True:
        for number in range(count):
            with open(folder / f".place_{number}", "w") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                yield
                return
        time.sleep(SECONDS)


def submit(jobs: list[Job], where: str, folder: Path, parameters: dict[str, Any]) -> list[str]:
    """Give jobs to submitit, on SLURM as one array; their numbers there. Raises `InputError`."""
    try:
        from submitit import AutoExecutor
    except ImportError:
        raise InputError(
            "--submit", "", "the 'cluster' extra: pip install 'avatarrex-studio[cluster]'", "no submitit"
        ) from None
    try:
        executor = AutoExecutor(folder / "submitit", cluster=where)
        executor.update_parameters(name="avatarrex", **parameters)
        with executor.batch():
            submitted = [executor.submit(job) for job in jobs]
    except (RuntimeError, ValueError, TypeError, NameError, OSError) as error:
        raise InputError("--submit", where, "a queue that takes jobs", str(error) or type(error).__name__) from None
    return [str(entry.job_id) for entry in submitted]


def jobs_below(folder: Path) -> list[Path]:
    """Folders of jobs: `folder` itself, those in it, and those of a `jobs` folder in or below it, by name."""
    found = {file.parent for pattern in ("job.json", "*/job.json", "jobs/*/job.json", "*/jobs/*/job.json")
             for file in folder.glob(pattern) if what_is(file) == "a file"}  # fmt: skip
    return sorted(found)


def dead(job: Job) -> bool:
    """Whether it is at work or queued by its own word, and nobody works on it."""
    beat = Heartbeat.read(job.path)
    return job.state in ("queued", "running") and beat is not None and not beat.alive()


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


def _value(words: tuple[str, ...], option: str) -> str:
    """Of an option on a command line; empty where it is not there."""
    for number, word in enumerate(words):
        if word.startswith(option + "="):
            return word.partition("=")[2]
        if word == option and number + 1 < len(words):
            return words[number + 1]
    return ""
