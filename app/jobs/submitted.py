"""A verb of the command line that runs elsewhere: what its job's folder says, and the function that does it there.

    JOBS/0001-train-a/job.json        words, state, tries, exit code
                      heartbeat.json  that it lives, as in a run folder
                      log             what the verb prints

submitit calls the function in a process of its own on this machine, or on one of a SLURM cluster (job_queue.py); the verb
runs in a child of that, and dies with it. A child that is killed begins again, up to `TRIES` times: a training goes on from
its last checkpoint.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from avatarrex_studio.jobs.training_process import COMMAND

from avatarrex.training.runs.control import Heart, Heartbeat, read_json, write_json

FORMAT = 1
TRIES = 5
"""Beginnings of a verb that is killed."""
SECONDS = 1.0
"""Between two looks for a free place."""
STOPPED = 130
STATES = ("queued", "running", "finished", "stopped", "failed")
SAVING_SECONDS = 120.0
"""Between the signal that a machine is taken away and its end: a training saves in it."""
DIES_WITH_PARENT = 1
"""Of `prctl`: PR_SET_PDEATHSIG."""
_C = ctypes.CDLL(None)


@dataclass(frozen=True)
class Job:
    """One command line, and its folder."""

    folder: str
    words: tuple[str, ...]
    cwd: str = field(default_factory=os.getcwd)
    """Where the command line was typed: relative paths in it start there."""
    where: str = "local"
    at_once: int = 0
    """Jobs of the folder's neighbours that run at a time on this machine, where it is `local`; 0: all."""
    slurm: dict[str, int | str] = field(default_factory=dict)
    """Options of SLURM by name, as typed."""
    owns: bool = False
    """Whether the run folder of a training had no run when the job began: the one in it by now is its own."""
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
        return Path(self.cwd, option_value(self.words, "--out")) if self.words[0] == "train" else None

    @classmethod
    def read(cls, path: Path) -> Job | None:
        """The job in a folder; None where there is none that can be read."""
        data = read_json(path / "job.json")
        if data is None or data.get("format") != FORMAT or data.get("state") not in STATES:
            return None
        words = data.get("words")
        if not isinstance(words, list) or not words or not all(isinstance(word, str) for word in words):
            return None
        known = {name: data[name] for name, kind in KINDS.items() if isinstance(data.get(name), kind)}
        return cls(str(path), tuple(words), **known)

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
            with place(self.path.parent, self.at_once if self.where == "local" else 0):
                return self._repeated()
        finally:
            heart.stop()

    def checkpoint(self) -> Any:
        """What submitit queues again when SLURM takes the machine away: this job; its verb has saved before."""
        from submitit.helpers import DelayedSubmission

        child = _CHILDREN.get(self.folder)
        if child is not None:
            _stop(child)
        return DelayedSubmission(self._as_kept().written(state="queued", tries=0))

    def _as_kept(self) -> Job:
        """What the folder says by now: it is this job that submitit has, as it was submitted."""
        return Job.read(self.path) or self

    def _repeated(self) -> int:
        job = self._as_kept()
        while True:
            begun = job.run is not None and (job.run / "run.json").exists()
            job = job.written(state="running", tries=job.tries + 1, code=None, owns=job.owns or not begun)
            code = job._once(resume=job.owns and begun)
            if code >= 0 or job.tries >= TRIES:
                break
        state = {0: "finished", STOPPED: "stopped"}.get(code, "failed")
        job.written(state=state, code=code)
        return code

    def _once(self, resume: bool) -> int:
        words = [*self.words, *(["--resume"] if resume and "--resume" not in self.words else [])]
        with open(self.log, "ab") as output:
            child = subprocess.Popen(
                [*COMMAND, *words], stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, cwd=self.cwd,
                preexec_fn=_die_with_parent,
            )  # fmt: skip
            _CHILDREN[self.folder] = child
            try:
                return child.wait()
            finally:
                child.poll()  # reaps one that `checkpoint` has ended
                del _CHILDREN[self.folder]


KINDS = {
    "cwd": str, "where": str, "at_once": int, "slurm": dict, "owns": bool, "tries": int, "state": str, "code": int,
}  # fmt: skip
"""Of the fields in job.json that may be missing."""
_CHILDREN: dict[str, subprocess.Popen[bytes]] = {}
"""By the job's folder: what `checkpoint`, which submitit calls in a handler of signals, has to stop."""


def _die_with_parent() -> None:
    """In a child: a job that is killed leaves nobody at work in its output, who would meet the one that is submitted after it."""
    if sys.platform == "linux":
        _C.prctl(DIES_WITH_PARENT, signal.SIGKILL)


def _stop(child: subprocess.Popen[bytes]) -> None:
    """End a child as Ctrl+C does, in a handler of signals: without its lock, which the interrupted `child.wait` has."""
    until = time.monotonic() + 0.75 * SAVING_SECONDS
    with suppress(ProcessLookupError, ChildProcessError):
        os.kill(child.pid, signal.SIGINT)
        while os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            if time.monotonic() > until:
                os.kill(child.pid, signal.SIGKILL)
            time.sleep(0.05)


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


def option_value(words: Sequence[str], option: str) -> str:
    """Of an option on a command line; empty where it is not there."""
    for number, word in enumerate(words):
        if word.startswith(option + "="):
            return word.partition("=")[2]
        if word == option and number + 1 < len(words):
            return words[number + 1]
    return ""
