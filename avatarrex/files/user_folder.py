"""Where the system keeps what belongs to a user: data, what can be made again, what a program remembers."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from avatarrex.errors import InputError


def user_folder(variable: str, elsewhere: tuple[str, ...], mac: str) -> Path:
    """The folder that `variable` names, or `elsewhere` in the user's own; on macOS `mac` in the Library.

    Raises `InputError` for a user without a folder.
    """
    if sys.platform != "win32" and sys.platform != "darwin" and (folder := os.environ.get(variable)):
        return Path(folder)
    try:
        home = Path.home()
    except RuntimeError:
        raise InputError("HOME", "", f"the user's folder (or {variable})", "none") from None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    return home / "Library" / mac if sys.platform == "darwin" else home.joinpath(*elsewhere)
