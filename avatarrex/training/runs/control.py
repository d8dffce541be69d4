"""The small JSON files of a run folder: what it is, that it lives, and what a viewer requests.

    run.json        config, versions, seed, when it started, and its state; whole at all times
    heartbeat.json  process, part, pass, step and steps of a run at work, rewritten every two seconds
    control.json    what a viewer requests: run, pause or stop

Nothing here needs torch: viewers read these files every second. Times are seconds since 1970, steps count from 0.
Spec: `assets_spec/run.json`.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from avatarrex.errors import CannotWrite, InputError, plain
from avatarrex.files import json_text
from avatarrex.files.gate import UNFINISHED

Wish = Literal["run", "pause", "stop"]
STATES = ("running", "paused", "finished", "stopped", "failed")
"""What run.json says. A running or paused run whose heart does not beat is shown as `dead`."""
BEAT_SECONDS = 2.0
DEAD_SECONDS = 15.0
"""Without a beat for so long, a run counts as dead: seven beats, for a machine that is short of time or memory."""


@dataclass(frozen=True)
class Heartbeat:
    """What a run at work says every `BEAT_SECONDS`."""

    time: float
    pid: int
    host: str
    part: str = ""
    pass_name: str = ""
    step: int = 0
    steps: int = 0
    """The step at which this part ends; 0 where nobody said."""

    @classmethod
    def read(cls, path: Path) -> Heartbeat | None:
        """The last beat of the run in folder `path`; None where there is none that can be read."""
        file = path / "heartbeat.json"
        try:
            beat = cls(**(read_json(file) or {}))
            numbers, words = (beat.pid, beat.step, beat.steps), (beat.host, beat.part, beat.pass_name)
            if not all(type(entry) is int and 0 <= entry < 2**31 for entry in numbers):
                return None
            if not all(isinstance(entry, str) for entry in words):
                return None
            host, part, pass_name = map(plain, words)
            latest = max(float(beat.time), file.stat().st_mtime)
            return replace(beat, time=latest, host=host, part=part, pass_name=pass_name)
        except (TypeError, ValueError, OSError):
            return None

    def alive(self, now: float | None = None) -> bool:
        """Whether the process still works: it beat lately, and is there where this machine can tell."""
        if (time.time() if now is None else now) - self.time > DEAD_SECONDS:
            return False
        return self.host != socket.gethostname() or _exists(self.pid)


def request(path: str | Path, wish: Wish) -> None:
    """Ask the run in folder `path` to go on, pause or stop. Raises `InputError` where that cannot be written."""
    write_json(Path(path) / "control.json", {"want": wish, "time": time.time()})


def wanted(path: str | Path) -> Wish:
    """What a viewer requests of the run in folder `path`; `run` where nothing or nothing readable was."""
    want = (read_json(Path(path) / "control.json") or {}).get("want")
    return want if want in ("pause", "stop") else "run"


def read_json(path: Path) -> dict[str, Any] | None:
    """The object in a JSON file; None where there is none, or it is broken or too large."""
    try:
        data = json_text.read_json(path, largest=json_text.SMALL)
    except InputError:
        return None
    return data if isinstance(data, dict) else None


def write_json(path: Path, data: dict[str, Any], lasting: bool = False) -> None:
    """Write a JSON file, all or nothing; `lasting`: also against a loss of power. Raises `InputError`."""
    text = json.dumps(data, indent=1, ensure_ascii=False) + "\n"
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f"{UNFINISHED}{path.stem}-")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                if lasting:
                    os.fsync(file.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(path, error) from None
    if lasting:
        sync_folder(path.parent)


def sync_folder(path: Path) -> None:
    """Flush a folder's list of names to the disk, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def cannot_write(path: Path, error: OSError) -> CannotWrite:
    """The one line for a file that could not be written: a full disk, a folder without rights."""
    return CannotWrite(path, "", "a file that can be written", error.strerror or error)


class Heart(threading.Thread):
    """Writes a beat every `BEAT_SECONDS` as long as the process lives, however long its steps take."""

    def __init__(self, path: Path, beat: Callable[[], Heartbeat]) -> None:
        super().__init__(name="heartbeat", daemon=True)
        self._path, self._beat = path / "heartbeat.json", beat
        self._stopped = threading.Event()

    def run(self) -> None:
        """Beat until stopped."""
        while not self._stopped.wait(BEAT_SECONDS):
            self.beat()

    def beat(self) -> None:
        """One beat, now. A disk that is full does not stop the run: the time of the file alone is then renewed."""
        try:
            write_json(self._path, asdict(self._beat()))
        except InputError:
            with contextlib.suppress(FileNotFoundError):
                os.utime(self._path)

    def stop(self) -> None:
        """Beat no more."""
        self._stopped.set()
        if self.is_alive():
            self.join()


def _exists(pid: int) -> bool:
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
