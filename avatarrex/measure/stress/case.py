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

from avatarrex.errors import InputError, check
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
    data = data if isinstance(data, dict) else {}
    known: dict[str, tuple[str, list[Any]]] = {
        "kind": ("a stress case", ["stress case"]),
        "format": (str(FORMAT), [FORMAT]),
    }
    for field, (expected, values) in {**known, "case": (" or ".join(kinds), list(kinds))}.items():
        found = data.get(field)
        check(type(found) is type(values[0]) and found in values, source, field, expected, found)
    check(isinstance(data.get("check"), str), source, "check", "the name of a check", data.get("check"))
    kind, given = kinds[data["case"]], data.get("inputs")
    names = sorted(given) if isinstance(given, dict) else given
    check(names == sorted(kind.entries), source, "inputs", ", ".join(kind.entries), names)
    inputs = {name: _array(source, f"inputs: {name}", entry, given[name]) for name, entry in kind.entries.items()}
    return kind, inputs, data["check"]


def _array(source: str, field: str, entry: Entry, given: Any) -> np.ndarray:
    check(isinstance(given, dict) and isinstance(given.get("values"), list), source, field, "shape and values", given)
    shape, values = given.get("shape"), given["values"]
    fits = isinstance(shape, list) and len(shape) == len(entry.shape) and all(type(n) is int for n in shape)
    fits = fits and all(0 <= n <= MOST_ROWS if want < 0 else n == want for n, want in zip(shape, entry.shape))
    found = f"{shape}, {len(values)} values"
    check(fits and math.prod(shape) == len(values), source, field, f"shape {entry.shape} and as many values", found)
    if entry.bounds is None:
        return np.array([_float(source, field, value) for value in values], dtype=np.float64).reshape(shape)
    low, high = entry.bounds
    for value in values:
        check(type(value) is int and low <= value <= high, source, field, f"integers from {low} to {high}", value)
    return np.array(values, dtype=np.int64).reshape(shape)


HEX = re.compile(r"-?(0x[01]\.?[0-9a-f]{0,13}p[+-][0-9]{1,4}|nan|inf)")


def _float(source: str, field: str, value: Any) -> float:
    known = isinstance(value, str) and HEX.fullmatch(value)
    check(known, source, field, "numbers as hexadecimal, e.g. 0x1.8p+1", value)
    try:
        return float.fromhex(value)
    except OverflowError:
        raise InputError(source, field, "a number of double precision", value) from None
