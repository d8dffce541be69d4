"""What goes with every file: who the person is, under which terms, and what the format lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from avatarrex.errors import InputError

UNSTATED = "not stated"
TERMS = ("licence", "consent", "authors")
"""Fields of `avatar.json` that a file without them says so of."""
CHOICES: dict[str, tuple[object, ...]] = {
    "avatarPermission": ("onlyAuthor", "onlySeparatelyLicensedPerson", "everyone"),
    "commercialUsage": ("personalNonProfit", "personalProfit", "corporation"),
    "creditNotation": ("required", "unnecessary"),
    "modification": ("prohibited", "allowModification", "allowModificationRedistribution"),
    "allowExcessivelyViolentUsage": (False, True),
    "allowExcessivelySexualUsage": (False, True),
    "allowPoliticalOrReligiousUsage": (False, True),
    "allowAntisocialOrHateUsage": (False, True),
    "allowRedistribution": (False, True),
}
"""What `allowed_use` of `avatar.json` may say, in the words of VRM 1.0; the first is the strictest, and what is not said."""
STRICTEST = {name: values[0] for name, values in CHOICES.items()} | {"creditNotation": "required"}

Losses = dict[str, float | str]
"""What is lost, in the words that are printed, and how much."""


@dataclass(frozen=True)
class Label:
    """Terms of the person, and the losses of one file."""

    name: str
    licence: str
    consent: str
    authors: tuple[str, ...]
    allowed_use: Mapping[str, object]
    provenance: Mapping[str, Any]
    """How the avatar was made, as `avatar.json` says."""
    losses: Losses = field(default_factory=dict)

    @classmethod
    def of(cls, meta: Mapping[str, Any]) -> Label:
        """Of an avatar's `avatar.json`. Raises `InputError` where it states an allowed use that there is not."""
        allowed = meta.get("allowed_use", {})
        if not isinstance(allowed, Mapping):
            raise InputError("avatar.json", "allowed_use", "an object", type(allowed).__name__)
        for name, value in allowed.items():
            if name not in CHOICES:
                raise InputError("avatar.json", f"allowed_use: {name}", "one of " + ", ".join(CHOICES), "another")
            if not any(value is choice or (value == choice and isinstance(value, str)) for choice in CHOICES[name]):
                raise InputError("avatar.json", f"allowed_use: {name}", " or ".join(map(str, CHOICES[name])), value)
        authors = meta.get("authors") or ()
        listed = isinstance(authors, (list, tuple)) and all(isinstance(author, str) for author in authors)
        if not (listed or isinstance(authors, str)):
            raise InputError("avatar.json", "authors", "a text or a list of texts", authors)
        for name in ("name", "licence", "consent"):
            if not isinstance(meta.get(name) or "", str):
                raise InputError("avatar.json", name, "a text", meta[name])
        return cls(
            name=str(meta.get("name") or "avatar"),
            licence=str(meta.get("licence") or UNSTATED),
            consent=str(meta.get("consent") or UNSTATED),
            authors=(authors,) if isinstance(authors, str) else tuple(authors),
            allowed_use=dict(allowed),
            provenance={key: meta[key] for key in ("origin", "person", "person_hash", "training") if key in meta},
        )

    @property
    def missing(self) -> tuple[str, ...]:
        """Of `TERMS`, what the avatar does not state."""
        stated = {
            "licence": self.licence != UNSTATED,
            "consent": self.consent != UNSTATED,
            "authors": bool(self.authors),
        }
        return tuple(name for name in TERMS if not stated[name])

    def json(self) -> dict[str, Any]:
        """Everything, as it is stored in files."""
        return {
            "name": self.name,
            "licence": self.licence,
            "consent": self.consent,
            "authors": list(self.authors) or [UNSTATED],
            "allowed_use": {**STRICTEST, **self.allowed_use},
            "not_stated": ", ".join(self.missing) or "nothing",
            "provenance": dict(self.provenance),
            "losses": self.losses,
        }

    def lines(self) -> list[str]:
        """Terms and losses for the terminal, and for comments of text files."""
        width = max(map(len, self.losses), default=0)
        terms = {"licence": self.licence, "consent": self.consent, "authors": ", ".join(self.authors) or UNSTATED}
        rows = [f"{what:<{width}}  {_shown(value)}" for what, value in self.losses.items()]
        return [f"{name}: {value}" for name, value in terms.items()] + rows


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
