"""The surface of an avatar, made in a process of its own at low priority; and the folder in which any distillation works.

    NAME.distil/poses/          what was observed so far (avatarrex/distil)
    NAME.distil/heartbeat.json  that a process works on it, and how far it is (training/runs/control.py)
    NAME.distil/distil.log      what a process in the background prints

The folder lies beside the avatar and is removed at the end. Nothing here needs torch.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

from avatarrex_studio.jobs.training_process import COMMAND, last_words

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, what_is
from avatarrex.training.runs.control import Heartbeat

log = logging.getLogger(__name__)
POSES, LOG, HEART = "poses", "distil.log", "heartbeat.json"
PARENT = "AVATARREX_PARENT"
"""Environment variable: the process without which a distillation in the background ends."""
NICE = 19
"""The lowest priority: whoever draws comes first."""
PATIENCE = 5.0
"""Seconds that the process has to end after the signal of Ctrl+C; then it is killed, and its poses are kept."""


def work_folder(avatar: Path) -> Path:
    """`NAME.distil` beside the avatar. Raises `InputError` where it cannot be written, or contains anything else."""
    folder = avatar.absolute().with_name(avatar.absolute().name.removesuffix(".avatar") + ".distil")
    check_writable(folder / HEART)
    if what_is(folder) == "a folder":
        others = sorted({name for name in os.listdir(folder) if name[0] != "."} - {POSES, LOG, HEART})
        if others:
            raise InputError(folder, "", "a folder of a distillation, which is removed at the end", others[0])
    return folder


def refuse_another(folder: Path) -> None:
    """Raise `InputError` where another process works in a work folder."""
    beat = Heartbeat.read(folder)
    if beat is not None and beat.alive():
        raise InputError(folder, "", "a distillation that no other process works on", f"process {beat.pid}")


def parent_ended() -> bool:
    """Whether the window that began this process has ended, however it did."""
    parent = os.environ.get(PARENT)
    return parent is not None and os.getppid() != int(parent)


class Distilling:
    """At most one distillation at a time, of an avatar that has no surface."""

    def __init__(self, command: Sequence[str] = COMMAND, device: str = "cpu") -> None:
        """Networks run on `device`."""
        self._command, self._device = tuple(command), device
        self._process: subprocess.Popen[bytes] | None = None
        self._folder = Path()
        self.avatar = Path()
        """The one that it was started for last."""
        self.error = ""
        """Why it ended without a surface; empty while it works, and where it did well."""

    def start(self, avatar: str | Path) -> None:
        """Begin, or go on. Raises `InputError` where the result could not be written beside the avatar, or one is at work."""
        path = Path(avatar).absolute()
        if self.working():
            raise InputError(path, "", "no other avatar to be distilled now", self.avatar.name)
        check_writable(path / "surface.safetensors" if path.is_dir() else path)
        self._folder, self.avatar, self.error = work_folder(path), path, ""
        refuse_another(self._folder)
        words = ["distil", str(path), *([] if self._device == "cpu" else ["--device", self._device])]
        try:
            self._folder.mkdir(exist_ok=True)
            with open(self._folder / LOG, "ab") as output:
                self._process = subprocess.Popen(
                    [*self._command, *words],
                    stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
                    env={**os.environ, PARENT: str(os.getpid())},
                )  # fmt: skip
            if hasattr(os, "setpriority"):
                os.setpriority(os.PRIO_PROCESS, self._process.pid, NICE)
        except OSError as error:
            raise InputError(self._folder, "", "a folder to work in", error.strerror or error) from None
        log.info("%s: distilling its surface", path.name)

    def progress(self) -> tuple[str, int, int] | None:
        """What is being made, how many steps of it are done, of how many; None where nobody knows or works."""
        if not self.working():
            return None
        beat = Heartbeat.read(self._folder)
        if beat is None or self._process is None or beat.pid != self._process.pid or not beat.pass_name:
            return None
        return beat.pass_name, beat.step, beat.steps

    def working(self) -> bool:
        """Whether the process is at work."""
        return self._process is not None and self._look() is None

    def close(self) -> None:
        """End the process with the window; the poses that it observed are kept."""
        process, self._process = self._process, None
        if process is None or process.poll() is not None:
            return
        process.send_signal(signal.SIGINT)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _look(self) -> int | None:
        """The exit code, None before; says once why it failed."""
        code = self._process.poll() if self._process is not None else None
        if code and not self.error:
            self.error = last_words(self._folder / LOG) or f"exit code {code}"
            log.error("%s: %s", self.avatar.name, self.error)
        return code
