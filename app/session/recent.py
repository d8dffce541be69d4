"""What was opened last, kept between runs: absolute paths, newest first, in `recent.json` of the user's state folder."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from avatarrex_studio.session.user_library import state_folder

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import SMALL, read_json, write_json

log = logging.getLogger(__name__)
MOST = 12


class Recent:
    """The list; a file that cannot be read or written is said in the log and ends nothing."""

    def __init__(self, file: Path | None = None) -> None:
        self.file = file or state_folder() / "recent.json"
        self.paths: tuple[str, ...] = ()
        self.gone: frozenset[str] = frozenset()
        """Those that were not there when `look` was last called."""
        self.read()

    def read(self) -> None:
        """Read the file, where there is one; entries that are no absolute paths are left out."""
        self.paths = ()
        if what_is(self.file) == "nothing there":
            return
        try:
            data = read_json(self.file, "a list of paths", SMALL)
            if not isinstance(data, list):
                raise InputError(self.file, "", "a list of paths", type(data).__name__)
        except InputError as error:
            log.warning("%s", error)
            return
        kept = (entry for entry in data if isinstance(entry, str) and entry.isprintable() and os.path.isabs(entry))
        self.paths = tuple(dict.fromkeys(kept))[:MOST]

    def add(self, path: str) -> None:
        """Put a path first. Another window's entries are kept; what is not on the disk, such as `default`, is not added."""
        if what_is(path) not in ("a file", "a folder"):
            return
        self.read()
        path = os.path.abspath(path)
        self.paths = (path, *(entry for entry in self.paths if entry != path))[:MOST]
        try:
            write_json(self.file, list(self.paths))
        except InputError as error:
            log.warning("%s", error)

    def look(self) -> None:
        """See which are gone."""
        self.gone = frozenset(path for path in self.paths if what_is(path) not in ("a file", "a folder"))
