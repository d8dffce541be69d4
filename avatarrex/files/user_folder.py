"""Where the system keeps what belongs to a user: data, what can be made again, what a program remembers."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def user_folder(variable: str, elsewhere: tuple[str, ...], mac: str) -> Path:
    """The folder that `variable` names, or `elsewhere` in the user's own; on macOS `mac` in the Library."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / mac
    return Path(os.environ.get(variable) or Path.home().joinpath(*elsewhere))
