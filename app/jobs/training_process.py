"""Trainings in processes of their own: started by the studio, paused and stopped through their run folder's control file.

A training outlives the window that started it. What it prints goes to `RUN/train.log`.
"""

from __future__ import annotations

import logging
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.session.notice import NOTICE

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.training.recipe import TRAINED
from avatarrex.training.runs.control import request

log = logging.getLogger(__name__)
STOPPED = 130
"""Exit code of a training that was stopped and can go on (cli/train.py)."""
INTERRUPTIBLE = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
"""What a process does first that is to end by the signal of Ctrl+C: of a window started by a shell's `&` it inherits that it is ignored."""
COMMAND = (sys.executable, "-c", INTERRUPTIBLE + "from avatarrex_studio.cli.main import main; raise SystemExit(main())")
PATIENCE = 60.0
"""Seconds that a training has to end by itself; then it gets the signal of Ctrl+C."""


@dataclass(frozen=True)
class Order:
    """A training to start."""

    capture: str
    """A folder or zip."""
    recipe: str
    """One of `RECIPES`."""
    out: Path
    parts: Sequence[str] = TRAINED
    start: str = ""
    """An avatar to go on from."""
    force: bool = False
    """Whether a capture is trained on that `capture check` calls unusable."""


@dataclass
class _Child:
    process: subprocess.Popen[bytes]
    stop_by: float | None = None
    """When to send the signal, in seconds of the clock."""
    stopped: bool = False
    """Whether a person had it stopped."""


class TrainingProcesses:
    """The trainings that this program started."""

    def __init__(
        self, command: Sequence[str] = COMMAND, clock: Callable[[], float] = time.monotonic, device: str = "cpu"
    ) -> None:
        """Networks that are trained run on `device`."""
        self._command, self._clock, self._device = tuple(command), clock, device
        self._children: dict[Path, _Child] = {}
        self.message = ""
        """The last thing to tell: a start, an end, an error."""

    def start(self, order: Order, resume: bool = False) -> None:
        """Start what `train` starts with that order. Raises `InputError` for what can be seen to be wrong before."""
        capture, out = order.capture.strip(), Path(order.out).absolute()
        if not capture:
            raise InputError("capture", "", "a capture folder or zip", "nothing")
        if not order.parts:
            raise InputError("parts", "", " or ".join(TRAINED), "none")
        if out in self._children:
            raise InputError(out, "", "a run that is not at work", "a training that was started here")
        if not resume and what_is(out / "run.json") == "a file":
            raise InputError(out, "", "a folder without a run (resume it instead)", "run.json")
        words = ["train", capture, "--recipe", order.recipe, "--out", str(out), "--parts", ",".join(order.parts)]
        words += ["--start", order.start] if order.start else []
        words += ["--force"] if order.force else []
        words += [] if self._device == "cpu" else ["--device", self._device]
        try:
            out.mkdir(parents=True, exist_ok=True)
            with open(out / "train.log", "ab") as output:
                process = subprocess.Popen(
                    [*self._command, *words, *(["--resume"] if resume else [])],
                    stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
                )  # fmt: skip
        except OSError as error:
            raise InputError(out, "", "a folder to train in", error.strerror or error) from None
        self._children[out] = _Child(process)
        self.message = f"{out.name}: training started"

    def stop(self, out: Path) -> None:
        """A run saves and ends; one that was started here gets the signal of Ctrl+C where it does not."""
        request(out, "stop")
        child = self._children.get(Path(out).absolute())
        if child is not None:
            child.stop_by, child.stopped = self._clock() + PATIENCE, True

    def working(self, out: Path) -> bool:
        """Whether a training that was started here works in folder `out`."""
        return Path(out).absolute() in self._children

    @property
    def paths(self) -> list[Path]:
        """Folders of the trainings that were started here and are at work."""
        self.poll()
        return list(self._children)

    def poll(self) -> None:
        """See which have ended, and interrupt those that do not stop."""
        for out, child in list(self._children.items()):
            code = child.process.poll()
            if code is None:
                if child.stop_by is not None and self._clock() > child.stop_by:
                    child.process.send_signal(signal.SIGINT)
                    child.stop_by = None
                continue
            del self._children[out]
            if code == 0:
                self.message = f"{out.name}: training ended"
                log.info("%s", self.message)
            elif child.stopped and code in (STOPPED, -signal.SIGINT):
                self.message = f"{out.name}: stopped; Continue goes on from its last checkpoint"
                log.log(NOTICE, "%s", self.message)
            else:
                self.message = f"{out.name}: {last_words(out / 'train.log') or f'exit code {code}'}"
                log.error("%s", self.message)


def last_words(path: Path) -> str:
    """The last line of a training's output."""
    try:
        with open(path, "rb") as file:
            file.seek(max(path.stat().st_size - 4096, 0))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return ""
    lines = [line.strip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    return lines[-1] if lines else ""
