"""Commands as JSON, `{"command": name, …}`: what a session file contains of each."""

from __future__ import annotations

from typing import Any

from avatarrex_studio.session.commands import Command, Setting

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals


def to_json(command: Command) -> dict[str, Any]:
    """Its name and fields, plain values."""
    content = {name: value.to_json() if isinstance(value, Signals) else value for name, value in vars(command).items()}
    return {"command": type(command).__name__, **content}


def from_json(data: Any, source: str = "session") -> Command:
    """The command that `to_json` wrote. Raises `InputError`."""
    name = data.get("command") if isinstance(data, dict) else None
    if name not in KINDS:
        raise InputError(source, "command", "the name of a command", name)
    content = {key: _read(key, value, source) for key, value in data.items() if key != "command"}
    try:
        return KINDS[name](**content)
    except TypeError as error:
        raise InputError(source, name, "the fields of that command", error) from None


KINDS: dict[str, type[Command]] = {
    kind.__name__: kind for kind in (*Command.__subclasses__(), *Setting.__subclasses__()) if kind is not Setting
}
"""Commands by name."""


def _read(key: str, value: Any, source: str) -> Any:
    if key == "signals":
        return Signals.from_json(value, source)
    return tuple(value) if isinstance(value, list) else value
