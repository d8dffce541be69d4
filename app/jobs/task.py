"""A verb of the command line that the window has done: captures made, checked and refined, avatars evaluated.

One at a time, in a process of its own, which ends with the window. What it prints goes to the task's log.
"""

from __future__ import annotations

import logging
import re
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.jobs.training_process import COMMAND, last_words
from avatarrex_studio.session.notice import NOTICE

from avatarrex.errors import InputError

log = logging.getLogger(__name__)
PATIENCE = 10.0
"""Seconds that a process has to end after the signal of Ctrl+C; then it is killed."""
UNUSABLE = 1
"""Exit code of a check, and of a look, whose verdict on a capture is that: the answer that they are for."""
MOST_TEXT = 64 * 1024
"""Bytes of the log's end that are shown."""

BAR = re.compile(r"(?P<what>.*?):? *(?P<percent>\d+)%\|.*\| *(?P<count>\S+) \[\S+<(?P<left>[^,\]]+)")
"""A line of tqdm: `check body:  75%|███ | 3/4 [00:04<00:01,  1.49s/frame]`."""


@dataclass(frozen=True)
class Progress:
    """How far a task is, as it said last."""

    share: float
    """0 to 1."""
    words: str

    @classmethod
    def read(cls, line: str) -> Progress | None:
        """Of a line of tqdm; None of any other."""
        if not (found := BAR.match(line)):
            return None
        words = f"{found['what']} {found['count']}, {found['left']} left".strip()
        return cls(int(found["percent"]) / 100, words)


@dataclass(frozen=True)
class Task:
    """What is to be done."""

    title: str
    """As a person knows it, e.g. `Check small`."""
    words: tuple[str, ...]
    """The verb and its options."""
    log: Path
    pictures: tuple[Path, ...] = ()
    """Files that it may write, to be shown where there is an answer."""
    capture: str = ""
    """The capture that it makes."""
    bad: tuple[int, ...] = ()
    """Exit codes beside 0 that are an answer, too."""


@dataclass(frozen=True)
class Outcome:
    """How it ended."""

    task: Task
    code: int
    text: str
    """What it printed."""
    cancelled: bool = False

    @property
    def done(self) -> bool:
        """Whether there is an answer: none of one that was cancelled, with whichever code it ended."""
        return not self.cancelled and self.code in (0, *self.task.bad)


def beside(path: str | Path, ending: str) -> str:
    """`path` with `ending` after its name; empty where it has none: `/`, `.` and what ends in `..`."""
    path = Path(path)
    return "" if path.name in ("", "..") else str(path.with_name(path.name + ending))


class Tasks:
    """The one at work, and the last that ended."""

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self.task: Task | None = None
        """What is at work."""
        self.outcome: Outcome | None = None
        """Of the last one."""
        self._command = tuple(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled = False

    def start(self, task: Task) -> None:
        """Begin. Raises `InputError` while another one is at work, and where the log cannot be written."""
        if self.task is not None:
            raise InputError(task.title, "", "nothing else to be at work in this tab", self.task.title)
        try:
            task.log.parent.mkdir(parents=True, exist_ok=True)
            with open(task.log, "wb") as output:
                self._process = subprocess.Popen(
                    [*self._command, *task.words],
                    stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
                )  # fmt: skip
        except OSError as error:
            raise InputError(task.log, "", "a file that can be written", error.strerror or error) from None
        self.task, self._cancelled = task, False

    @property
    def line(self) -> str:
        """The last that it printed."""
        return last_words(self.task.log) if self.task else ""

    def cancel(self) -> None:
        """Give it the signal of Ctrl+C."""
        if self._process is not None:
            self._cancelled = True
            self._process.send_signal(signal.SIGINT)

    def poll(self) -> Outcome | None:
        """The outcome of the one that has just ended."""
        code = self._process.poll() if self._process else None
        task = self.task
        if code is None or task is None:
            return None
        self.outcome = Outcome(task, code, text_of(task.log), self._cancelled)
        self._process = self.task = None
        if self._cancelled:
            log.log(NOTICE, "%s: cancelled", task.title)
        elif self.outcome.done:
            log.log(NOTICE, "%s: done", task.title)
        else:
            log.error("%s: %s", task.title, last_words(task.log) or f"exit code {code}")
        return self.outcome

    def close(self) -> None:
        """End it with the window."""
        if self._process is None:
            return
        self.cancel()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def text_of(path: Path) -> str:
    """The end of a log, of each line what a terminal would show of it, without bars; empty where it cannot be read."""
    try:
        with open(path, "rb") as file:
            file.seek(max(path.stat().st_size - MOST_TEXT, 0))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return ""
    lines = [line.rstrip("\r").rpartition("\r")[2].rstrip() for line in text.split("\n")]
    return "\n".join(line for line in lines if not BAR.match(line)).strip()
