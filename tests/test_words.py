"""Words that are gone: the code and its documents use the field's terms (docs/glossary.md says which words are ours)."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("avatarrex", "app", "shaders", "tests", "tools", "examples")
CODE = (".py", ".glsl", ".comp", ".vert", ".frag")
RECORDS = ("glossary.md", "experiments.md", "test_words.py")
"""Pages that may name what was, or what a word of ours replaces."""

GONE = re.compile(
    r"(?<![a-z])(?:asked|asks|hears?|heard|worn|crumbs?|handless|pace|hold|held(?![-_\s]out))(?![a-z])"
    r"|\b(?:comes?|came)\s+to\s+rest\b|\bwhat\s+stands\s+still\b|\btold\s+apart\b",
    re.IGNORECASE,
)
"""Whole words, also inside identifiers, which `_` splits. 'Held-out' and `holding_out` stay."""
NAMES_GONE = {"probe": "", "probes": "", "arm": "avatarrex/measure/", "arms": "avatarrex/measure/"}
"""Words of identifiers, in which folder: a probe as a distance; arms as the variants of an ablation study."""
KEPT = {
    ("avatarrex/fields/body.py", "worn"),  # a buffer's name in avatars that exist
}
"""Places (file, word) that keep a word: what is on disk, or what a command line of before still says."""


def read() -> dict[str, str]:
    """Every text that is looked at, by its path."""
    code = [
        path for room in ROOMS for path in (ROOT / room).rglob("*") if path.suffix in CODE and path.name not in RECORDS
    ]
    pages = [path for path in (ROOT / "docs").glob("*.md") if path.name not in RECORDS]
    paths = [*code, *pages, *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in sorted(paths)}


def words(path: str, text: str) -> Iterator[tuple[int, str]]:
    """Line and word of everything that should be gone from a text."""
    for match in GONE.finditer(text):
        if (path, match[0].lower()) not in KEPT:
            yield text.count("\n", 0, match.start()) + 1, match[0]
    if path.endswith(".py"):
        yield from names(path, text)


def names(path: str, text: str) -> Iterator[tuple[int, str]]:
    """Line and identifier of a Python file with a word that is gone from identifiers."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME:
            for word in re.findall("[a-z]+", token.string.lower()):
                if word in NAMES_GONE and path.startswith(NAMES_GONE[word]):
                    yield token.start[0], token.string


def test_the_words_are_gone() -> None:
    found = [f"{path}:{line}: {word}" for path, text in read().items() for line, word in words(path, text)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "_asked = 1",
        "HELD = 2",
        "it comes\n  to rest",
        "probe_step = 1",
        "arms = ()",
        "for arm in arms: pass",
        "handless_body",
        "# Asks",
    ],
)
def test_a_word_is_found(text: str) -> None:
    assert list(words("avatarrex/measure/a.py", text))


@pytest.mark.parametrize(
    "text", ["space, task, threshold", "held_out = 'held-out, held out'", "def holding_out(): ...", "'--arms'"]
)
def test_other_words_stay(text: str) -> None:
    assert not list(words("avatarrex/measure/a.py", text))
