"""A stress case: its kind and its exact inputs, and how it goes into a file and comes back to the last bit.

A kind says what its inputs are (`Entry`: the validator of a file from anywhere), draws them, checks them, and which of them
may be made simpler when a failure is shrunk. Floats are written as hexadecimal, so that nothing is rounded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.json_text import parse_json
from avatarrex.measure.stress.findings import Finding, Findings

FORMAT = 1
MOST_ROWS = 100_000
"""Rows of an array of free length."""
Inputs = dict[str, np.ndarray]


@dataclass(frozen=True)
class Entry:
    """One input: float64, or int64 where it has bounds. A length of −1 is free."""

    shape: tuple[int, ...]
    bounds: tuple[int, int] | None = None
    """Lowest and highest integer."""


@dataclass(frozen=True)
class Kind:
    """A kind of case."""

    name: str
    entries: Mapping[str, Entry]
    draw: Callable[[np.random.Generator, int], Inputs]
    """Inputs of the case of that number, all random choices from the generator."""
    check: Callable[[Inputs, Findings], None]
    repeat: int
    """One case in so many is checked twice, and must give the same bits."""
    simpler: tuple[str, ...] = ()
    """Inputs that may be zeroed, as a whole or row by row, and halved."""
    fewer: tuple[str, ...] = ()
    """Inputs of which rows may be left out."""


def examine(kind: Kind, inputs: Inputs, repeated: bool) -> list[Finding]:
    """Run a case's checks; what it raises is a finding, too."""
    found = Findings()
    try:
        kind.check(inputs, found)
        if repeated:
            again = Findings()
            kind.check(inputs, again)
            found.flag("same bits again", again.digest == found.digest)
    except Exception as error:  # whatever it is: the search goes on, and the case is reported with it
        found.flag("raises nothing", False, f"{type(error).__name__}: {error}")
    else:
        found.flag("raises nothing", True)
    return found.found


def to_json(kind: Kind, inputs: Inputs, finding: Finding) -> dict[str, Any]:
    """A replay file's content: the case, and the finding that it is about."""
    return {
        "format": FORMAT,
        "kind": "stress case",
        "case": kind.name,
        "check": finding.check,
        "figure": float(finding.figure).hex(),
        "tolerance": float(finding.tolerance).hex(),
        "note": finding.note,
        "inputs": {name: _plain(entry, inputs[name]) for name, entry in kind.entries.items()},
    }


def _plain(entry: Entry, value: np.ndarray) -> dict[str, Any]:
    numbers = [float(x).hex() if entry.bounds is None else int(x) for x in value.ravel()]
    return {"shape": list(value.shape), "values": numbers}


def from_json(data: Any, kinds: Mapping[str, Kind], source: str) -> tuple[Kind, Inputs, str]:
    """Kind, inputs and the name of the check that failed. Raises `InputError`."""
    if isinstance(data, str):
        data = parse_json(data, source)
    if not isinstance(data, dict) or data.get("kind") != "stress case":
        raise InputError(source, "kind", "a stress case", type(data).__name__)
    if data.get("format") != FORMAT or isinstance(data["format"], bool):
        raise InputError(source, "format", str(FORMAT), data.get("format"))
    if not isinstance(data.get("case"), str) or data["case"] not in kinds:
        raise InputError(source, "case", " or ".join(kinds), data.get("case"))
    if not isinstance(data.get("check"), str):
        raise InputError(source, "check", "the name of a check", data.get("check"))
    kind, given = kinds[data["case"]], data.get("inputs")
    if not isinstance(given, dict) or set(given) != set(kind.entries):
        raise InputError(source, "inputs", ", ".join(kind.entries), sorted(given) if isinstance(given, dict) else given)
    inputs = {name: _array(source, name, entry, given[name]) for name, entry in kind.entries.items()}
    return kind, inputs, data["check"]


def _array(source: str, name: str, entry: Entry, given: Any) -> np.ndarray:
    field = f"inputs: {name}"
    if not isinstance(given, dict) or not isinstance(given.get("values"), list):
        raise InputError(source, field, "shape and values", given)
    shape: Any = given.get("shape")
    values = given["values"]
    known = isinstance(shape, list) and len(shape) == len(entry.shape)
    free = (range(MOST_ROWS + 1) if want < 0 else (want,) for want in entry.shape)
    fits = known and all(type(n) is int and n in allowed for n, allowed in zip(shape, free))
    if not fits or math.prod(shape) != len(values):
        raise InputError(source, field, f"shape {entry.shape} and as many values", f"{shape}, {len(values)} values")
    if entry.bounds is None:
        return np.array([_float(source, field, value) for value in values], dtype=np.float64).reshape(shape)
    low, high = entry.bounds
    for value in values:
        if type(value) is not int or not low <= value <= high:
            raise InputError(source, field, f"integers from {low} to {high}", value)
    return np.array(values, dtype=np.int64).reshape(shape)


HEX = re.compile(r"-?(0x[01]\.?[0-9a-f]{0,13}p[+-][0-9]{1,4}|nan|inf)")


def _float(source: str, field: str, value: Any) -> float:
    if not isinstance(value, str) or not HEX.fullmatch(value):
        raise InputError(source, field, "numbers as hexadecimal, e.g. 0x1.8p+1", value)
    try:
        return float.fromhex(value)
    except OverflowError:
        raise InputError(source, field, "a number of double precision", value) from None
