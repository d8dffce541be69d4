"""The one error a user's input can cause."""

from __future__ import annotations


class InputError(ValueError):
    """A file, option or value from outside was refused.

    `source` names the file or option, `field` the key in it. The message is one line:
    ``walk.npz: poses: expected shape (frames, 165), found (12, 72)``.
    """

    def __init__(self, source: object, field: str, expected: str, found: object) -> None:
        self.source, self.field, self.expected, self.found = str(source), field, expected, str(found)
        place = f"{source}: {field}" if field else str(source)
        super().__init__(f"{place}: expected {expected}, found {found}".replace("\n", " "))
