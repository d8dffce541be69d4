"""In what a synthetic capture differs from the default one: whose body it is, how it is photographed, how well it is tracked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from avatarrex.capture.synthetic.identity import other_person, own_expressions
from avatarrex.capture.synthetic.subject import Subject
from avatarrex.errors import InputError

SUBJECTS = ("default", "other")
EXPRESSIONS = ("template", "own")
CONDITIONS = ("light", "exposure", "lens", "noise", "mattes", "texture")
"""light fixed in the world before a person who turns; a rig's exposure and white balance; lens distortion; sensor noise; mattes
1 to 2 pixels off; photographic texture detail (imaging.py, plan.py, detail.py)."""
MOST_NOISE = 10.0
"""Tracking noise beyond 20 degrees a joint is no tracking."""


@dataclass(frozen=True)
class Variation:
    """The default: nothing differs. Raises `InputError` for a name or number that is not known."""

    subject: str = "default"
    expressions: str = ""
    """Empty: the subject's, so that the other person has its own."""
    conditions: tuple[str, ...] = ()
    tracking_noise: float = 0.0
    """Times 2 degrees a joint, 1 cm of the root, 0.1 of the coefficients (tracking.py)."""

    def __post_init__(self) -> None:
        _known("--subject", self.subject, SUBJECTS)
        _known("--expressions", self.expressions or self._own, EXPRESSIONS)
        for name in self.conditions:
            _known("--conditions", name, CONDITIONS)
        if not 0 <= self.tracking_noise <= MOST_NOISE:
            raise InputError("--tracking-noise", "", f"a factor from 0 to {MOST_NOISE:g}", self.tracking_noise)
        object.__setattr__(self, "expressions", self.expressions or self._own)
        object.__setattr__(self, "conditions", tuple(name for name in CONDITIONS if name in self.conditions))

    @property
    def _own(self) -> str:
        return "template" if self.subject == "default" else "own"

    def has(self, condition: str) -> bool:
        """Whether one of `CONDITIONS` is on."""
        return condition in self.conditions

    def applied(self, subject: Subject) -> Subject:
        """`subject` as this variation has it."""
        if self.subject == "other":
            subject = other_person(subject)
        if self.expressions == "own":
            subject = own_expressions(subject)
        return replace(subject, detailed=True) if self.has("texture") else subject

    def to_json(self) -> dict[str, Any]:
        """Plain values, of what differs alone."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in vars(self).items()
            if value != getattr(DEFAULT, name)
        }


def conditions(text: str) -> tuple[str, ...]:
    """Names from a list with commas, "all" or "none"."""
    if text in ("all", "none"):
        return CONDITIONS if text == "all" else ()
    return tuple(name.strip() for name in text.split(","))


def _known(option: str, value: str, known: Iterable[str]) -> None:
    if value not in known:
        listed = ", ".join(known) + (", all or none" if option == "--conditions" else "")
        raise InputError(option, "", "one of " + listed, value)


DEFAULT = Variation()
"""Nothing differs."""
