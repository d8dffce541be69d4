"""The one error a user's input can cause."""

from __future__ import annotations


class InputError(ValueError):
    """A file, option or value from outside was refused.

    `source` names the file or option, `field` the key in it. The message is one line:
    ``walk.npz: poses: expected shape (frames, 165), found (12, 72)``.
    """

    def __init__(self, source: object, field: str, expected: str, found: object) -> None:
        self.source, self.field, self.expected, self.found = str(source), field, expected, _short(str(found))
        place = f"{source}: {field}" if field else str(source)
        super().__init__(plain(f"{place}: expected {expected}, found {self.found}"))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """It crosses from one process to another."""
        return type(self), (self.source, self.field, self.expected, self.found)


class CannotWrite(InputError):
    """The disk does not take a file. What passes over damaged input must not pass over this."""


def check(ok: object, source: object, field: str, expected: str, found: object) -> None:
    """Raise `InputError` unless `ok`."""
    if not ok:
        raise InputError(source, field, expected, found)


def _short(text: str) -> str:
    """What was found may be a whole file: its beginning says enough."""
    return text if len(text) <= 300 else text[:300] + "…"


def plain(text: str) -> str:
    """One line without control characters: what a file contains must not reach a terminal or window as commands."""
    return "".join(letter if letter.isprintable() else " " if letter.isspace() else "�" for letter in text)
