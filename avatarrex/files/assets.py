"""Packaged data, and `.npz` files: read without unpickling, checked against `assets_spec/<name>.json`.

A spec names each array with its shape (letters bind to one length per file), kind of number, unit and meaning; what it
does not name is not read.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is

DATA = Path(__file__).parents[1] / "data"
SPECS = Path(__file__).parents[1] / "assets_spec"
LARGEST = 2**31
"""Bytes that the arrays of one file may unpack to: a few MB of zip can claim any number."""
KINDS = {"float": "f", "integer": "iu", "text": "U"}


def read_npz(path: str | Path, spec_name: str) -> dict[str, np.ndarray]:
    """The arrays that `assets_spec/<spec_name>.json` names, checked against it.

    Raises `InputError` naming file and key: missing key, wrong shape or kind, NaN, truncated file, pickled array.
    """
    spec = read_spec(spec_name)
    arrays = read_arrays(path, spec["arrays"])
    check_arrays(arrays, path, spec)
    return arrays


def read_arrays(path: str | Path, only: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Every array of an `.npz` file, or those of `only` that it has. Raises `InputError` if it is missing or broken."""
    path = Path(path)
    found = what_is(path)
    if found != "a file":
        raise InputError(path, "", "an .npz file", found)
    name, arrays, total = "", {}, 0
    try:
        with zipfile.ZipFile(path) as members, np.load(path, allow_pickle=False) as archive:
            for name in archive.files if only is None else [key for key in only if key in archive.files]:
                entry = name if name in members.namelist() else name + ".npy"
                total += members.getinfo(entry).file_size
                if total > LARGEST:
                    raise InputError(path, name, f"arrays of at most {LARGEST >> 30} GiB", f"{total >> 20} MiB")
                arrays[name] = archive[name]
                if not isinstance(arrays[name], np.ndarray):
                    raise InputError(path, name, "a plain array (no pickled objects)", "other bytes")
            return arrays
    # RuntimeError: an encrypted archive; KeyError: a directory that does not fit its entries
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError, MemoryError, KeyError) as error:
        raise InputError(path, name, "a complete .npz file", error) from None
    except InputError:
        raise
    except (ValueError, OverflowError, struct.error) as error:
        raise InputError(path, name, "a plain array (no pickled objects)", error) from None


@lru_cache(maxsize=16)
def read_spec(name: str) -> dict[str, Any]:
    """A packaged spec, `assets_spec/<name>.json`."""
    return json.loads((SPECS / f"{name}.json").read_text(encoding="utf-8"))


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
