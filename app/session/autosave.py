"""The session as it is now and then written to a file of its own, so that a crash loses half a minute of work at most.

    FOLDER/recovery-PID.json    {"format": 1, "kind": "recovery", "path": …, "session": …}

The folder is the system's place for a program's state (`state_folder`). A clean end removes the file; one whose process is gone is work
that was lost. Files are written by a thread of their own: the interface does not wait.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.session.journal import SESSION_BYTES, Journal, Snapshot
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.user_library import state_folder

from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.files.json_text import read_json

log = logging.getLogger(__name__)
FORMAT = 1
EVERY = 30.0
"""Seconds between two writings, at least."""


@dataclass(frozen=True)
class Recovery:
    """A file that a process left behind when it crashed."""

    file: Path

    @property
    def when(self) -> str:
        """Day and time of the last writing."""
        return time.strftime("%d %b %H:%M", time.localtime(self.file.stat().st_mtime))

    def read(self) -> Journal:
        """The session, with its unsaved work. Raises `InputError`."""
        data = read_json(self.file, "a session that was kept", SESSION_BYTES)
        if not isinstance(data, dict) or data.get("kind") != "recovery" or data.get("format") != FORMAT:
            raise InputError(self.file, "kind", f"recovery, format {FORMAT}", type(data).__name__)
        journal = Journal.from_json(data.get("session"), str(self.file))
        path = data.get("path")
        journal.path, journal.saved = path if isinstance(path, str) else None, None
        return journal

    def discard(self) -> None:
        """Remove the file."""
        self.file.unlink(missing_ok=True)


class Autosave:
    """Keeps the unsaved work of this process."""

    def __init__(self, folder: Path | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.folder, self._clock = folder or state_folder(), clock
        self.file = self.folder / f"recovery-{os.getpid()}.json"
        self._thread = ThreadPoolExecutor(1, "autosave")
        self._writing: Future[None] | None = None
        self._kept: StudioState | None = None
        self._last = clock()

    def found(self) -> list[Recovery]:
        """What processes that are gone have left, the newest first."""
        files = [file for file in self.folder.glob("recovery-*.json") if _left_behind(file)]
        return [Recovery(file) for file in sorted(files, key=lambda file: -file.stat().st_mtime)]

    def tend(self, journal: Journal) -> None:
        """Write the session where it has changed and the last writing is long enough ago; remove it where all is saved."""
        if self._writing and not self._writing.done():
            return
        if not journal.unsaved:
            self._last = self._clock()
            if self._kept is not None:
                self._kept, self._writing = None, self._thread.submit(self.file.unlink, True)
        elif journal.state != self._kept and self._clock() - self._last >= EVERY:
            self.keep(journal)

    def keep(self, journal: Journal) -> None:
        """Write the session now, where it has unsaved work."""
        if journal.unsaved:
            self._kept, self._last = journal.state, self._clock()
            self._writing = self._thread.submit(self._write, journal.snapshot(), journal.path)

    def close(self) -> None:
        """A clean end: nothing is left behind."""
        self._thread.shutdown()
        self.file.unlink(missing_ok=True)

    def _write(self, snapshot: Snapshot, path: str | None) -> None:
        content = {"format": FORMAT, "kind": "recovery", "path": path, "session": snapshot.to_json()}
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_text(self.file, json.dumps(content, indent=1))  # indented: the interface's thread runs in between
        except (OSError, InputError) as error:
            log.warning("your work is not kept for the case of a crash: %s", error)


def _left_behind(file: Path) -> bool:
    """Whether the process that wrote the file is gone."""
    number = file.stem.removeprefix("recovery-")
    if not number.isdigit() or os.name != "posix":
        return number.isdigit() and int(number) != os.getpid()
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # another user's process, or no number of one
        return False
    return False
