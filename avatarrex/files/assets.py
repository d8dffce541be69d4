"""Packaged data, and `.npz` files: read without unpickling, checked against `assets_spec/<name>.json`.

A spec names each array with its shape (letters bind to one length per file), kind of number, unit and meaning; what it
does not name is not read.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays

DATA = Path(__file__).parents[1] / "data"
SPECS = Path(__file__).parents[1] / "assets_spec"
KINDS = {"float": "f", "integer": "iu", "text": "U"}


def read_npz(path: str | Path, spec_name: str) -> dict[str, np.ndarray]:
    """The arrays that `assets_spec/<spec_name>.json` names, checked against it.

    Raises `InputError` naming file and key: missing key, wrong shape or kind, NaN, truncated file, pickled array.
    """
    spec = read_spec(spec_name)
    arrays = read_arrays(path, spec["arrays"])
    check_arrays(arrays, path, spec)
    return arrays


@lru_cache(maxsize=16)
def read_spec(name: str) -> dict[str, Any]:
    """A packaged spec, `assets_spec/<name>.json`."""
    spec: dict[str, Any] = json.loads((SPECS / f"{name}.json").read_text(encoding="utf-8"))
    return spec


def check_arrays(arrays: dict[str, np.ndarray], source: str | Path, spec: dict[str, Any]) -> None:
    """Raise `InputError` for the first array that is missing or not as `spec` says."""
    sizes: dict[str, int] = {}
    for key, rule in spec["arrays"].items():
        if key not in arrays:
            if rule.get("required", True):
                raise InputError(source, key, "the key to be there", f"only {', '.join(sorted(arrays)[:12])}")
            continue
        value = arrays[key]
        if value.dtype.kind not in KINDS[rule["kind"]]:
            raise InputError(source, key, f"{rule['kind']} values", value.dtype)
        if len(rule["shape"]) == value.ndim:
            for letter, length in zip(rule["shape"], value.shape):
                sizes.setdefault(letter, length)
        require(arrays, source, key, tuple(n if isinstance(n, int) else sizes.get(n) for n in rule["shape"]))
    for choice in spec.get("one_of", []):
        if not any(all(key in arrays for key in option) for option in choice):
            wanted = " or ".join("+".join(option) for option in choice)
            raise InputError(source, choice[0][0], wanted, f"only {', '.join(sorted(arrays)[:12])}")


def require(arrays: dict[str, np.ndarray], source: str | Path, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """`arrays[key]`, checked: present, of `shape` (None admits any length), finite."""
    if key not in arrays:
        raise InputError(source, key, "the key to be there", f"only {', '.join(sorted(arrays)[:12])}")
    value = arrays[key]
    fits = value.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, value.shape))
    if not fits:
        wanted = ", ".join("any" if side is None else str(side) for side in shape)
        raise InputError(source, key, f"shape ({wanted}{',' if len(shape) == 1 else ''})", value.shape)
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        raise InputError(source, key, "finite numbers", f"{int((~np.isfinite(value)).sum())} NaN or Inf")
    return value


def numbers(value: np.ndarray, source: str | Path, key: str, largest: float) -> np.ndarray:
    """`value` as float64, checked: integers or floats, finite, at most `largest` in magnitude; differences of it cannot wrap."""
    if value.dtype.kind not in "fiu":
        raise InputError(source, key, "numbers", value.dtype)
    with np.errstate(over="ignore"):  # wider floats may be infinite then
        array = value.astype(np.float64)
    if not np.abs(array).max(initial=0) <= largest:  # also true of NaN
        raise InputError(source, key, f"finite numbers up to {largest:g}", f"{np.abs(array).max():g}")
    return array
