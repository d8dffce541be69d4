"""What a user prefers, kept between runs in `preferences.json` of the user's state folder: no part of a session.

A value that cannot be is said in the log, and its default takes its place.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from avatarrex_studio.session.user_library import state_folder

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import SMALL, read_json, write_json

log = logging.getLogger(__name__)
CHOICES = {
    "mouse": ("default", "blender", "maya"),
    "angles": ("degrees", "radians"),
    "lengths": ("m", "cm"),
    "theme": ("dark", "light"),
}
"""Names that a field may be, the default first."""
RANGES = {"scale": (0.7, 2.0), "fps": (10.0, 240.0)}
"""Numbers that a field may be."""


@dataclass(frozen=True)
class Preferences:
    """Raises `InputError` for what cannot be."""

    mouse: str = "default"
    """What the buttons do in the viewport."""
    angles: str = "degrees"
    lengths: str = "m"
    theme: str = "dark"
    scale: float = 1.0
    """Of text and all else, times what the screen needs."""
    fps: float = 60.0
    """Interface frames a second at most."""
    greeting: bool = True
    """Whether the avatar moves gently until the first thing that somebody does."""
    hint: bool = True
    """Whether the hint in the menu bar is shown."""

    def __post_init__(self) -> None:
        for item in fields(self):
            checked(item.name, getattr(self, item.name))


def checked(name: str, value: object, source: object = "preferences") -> Any:
    """The value of a field. Raises `InputError` for one that cannot be."""
    if name in CHOICES:
        good, expected = value in CHOICES[name], " or ".join(CHOICES[name])
    elif name in RANGES:
        low, high = RANGES[name]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        good, expected = number and low <= float(value) <= high, f"a number from {low:g} to {high:g}"  # type: ignore[arg-type]
    else:
        good, expected = isinstance(value, bool), "true or false"
    if not good:
        raise InputError(source, name, expected, value)
    return value


def preferences_file() -> Path:
    """Where they are kept."""
    return state_folder() / "preferences.json"


def read_preferences(file: Path | None = None) -> Preferences:
    """Those of the file; defaults for what is not there and for what is refused, which is said."""
    file = file or preferences_file()
    if what_is(file) == "nothing there":
        return Preferences()
    try:
        data = read_json(file, "preferences", SMALL)
        if not isinstance(data, dict):
            raise InputError(file, "", "an object", type(data).__name__)
    except InputError as error:
        log.warning("%s", error)
        return Preferences()
    kept: dict[str, Any] = {}
    if unknown := sorted(set(data) - {item.name for item in fields(Preferences)}):
        log.warning(
            "%s", InputError(file, unknown[0], ", ".join(item.name for item in fields(Preferences)), "an unknown name")
        )
    for name in (item.name for item in fields(Preferences) if item.name in data):
        try:
            kept[name] = checked(name, data[name], file)
        except InputError as error:
            log.warning("%s", error)
    return Preferences(**kept)


def write_preferences(preferences: Preferences, file: Path | None = None) -> None:
    """Keep them; a file that cannot be written is said and ends nothing."""
    try:
        write_json(file or preferences_file(), asdict(preferences))
    except InputError as error:
        log.warning("%s", error)
