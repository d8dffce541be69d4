"""JSON texts, judged before they are parsed: how many values, how deep they are nested.

Python takes up to 24 bytes of memory for a byte of JSON, so that the number of values is the limit and not only the size.
An integer beyond `MOST_DIGITS` becomes the nearest floating-point number, infinity at 400 digits: what checks that numbers are
finite refuses it by name.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from avatarrex.errors import InputError
from avatarrex.files.gate import read_text, write_text

JSON_BYTES = 2**28
"""Bytes of a file: a motion of as many values as are allowed."""
SMALL = 2**22
"""Bytes of a file that describes something: an avatar, a run, a checkpoint, a capture's rig."""
MOST_VALUES = 10_000_000
"""Half an hour of our own motion at 24 frames a second; 700 MB of memory at most."""
MOST_NESTED = 64
"""Brackets inside one another; our own files have a dozen."""
MOST_DIGITS = 40
"""Of an integer with its sign: 128 bits, the state of a random generator."""
_TOKEN = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+"|[\[\]{}]', re.DOTALL)


def read_json(path: str | Path, expected: str = "a JSON file", largest: int = JSON_BYTES) -> Any:
    """What a JSON file contains. Raises `InputError`."""
    return parse_json(read_text(path, expected, largest=largest), path, "", expected)


def write_json(path: str | Path, data: object) -> None:
    """Figures as a JSON file, whole or not at all. Raises `InputError` where it cannot be written, `ValueError` for NaN."""
    write_text(path, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def parse_json(text: str, source: object, field: str = "", expected: str = "JSON") -> Any:
    """What a JSON text contains. Raises `InputError`."""
    brackets = text.count("[") + text.count("{")
    values = brackets + text.count(",")
    if values > MOST_VALUES:
        raise InputError(source, field, f"{expected} of at most {MOST_VALUES:,} values", f"{values:,}")
    if brackets > MOST_NESTED:
        _check_depth(text, source, field, expected)
    try:
        return json.loads(text, parse_int=_integer)
    except json.JSONDecodeError as error:
        found = f"no JSON in line {error.lineno}, column {error.colno}" if text.strip() else "nothing"
        raise InputError(source, field, expected, found) from None


def _check_depth(text: str, source: object, field: str, expected: str) -> None:
    depth = 0
    for match in _TOKEN.finditer(text):
        if match[0] in "[{":
            depth += 1
            if depth > MOST_NESTED:
                raise InputError(
                    source, field, f"{expected} nested at most {MOST_NESTED} deep", "brackets nested too deeply"
                )
        elif match[0] in "]}":
            depth -= 1


def _integer(digits: str) -> int | float:
    return int(digits) if len(digits) <= MOST_DIGITS else float(digits)
