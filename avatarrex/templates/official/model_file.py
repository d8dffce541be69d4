"""The arrays of a published model, `.npz` or `.pkl`: plain, dense, and as `assets_spec/<kind>.json` has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import sparray

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import check_arrays, read_spec
from avatarrex.files.gate import read_head
from avatarrex.files.pickles import read_pickle

ZIP = b"PK"


def read_model_file(path: str | Path, kind: str, title: str) -> dict[str, np.ndarray]:
    """The arrays that the spec `kind` names; `title` says what the file should be. Raises `InputError` naming file and key."""
    spec = read_spec(kind)
    if read_head(path, f"{title} file (.npz or .pkl)", len(ZIP)) == ZIP:
        arrays = read_arrays(path, spec["arrays"])
    else:
        fields = read_dict(path, f"{title} file (.npz or .pkl)")
        rules = spec["arrays"].items()
        arrays = {key: _dense(path, key, fields[key], rule["shape"]) for key, rule in rules if key in fields}
    check_arrays(arrays, path, spec)
    return arrays


def read_dict(path: str | Path, expected: str) -> dict[Any, Any]:
    """A pickle, or an `.npy`, of a dict. Raises `InputError`."""
    fields = read_pickle(path, expected)
    if not isinstance(fields, dict):
        raise InputError(path, "", f"{expected} that holds a dict", type(fields).__name__)
    return fields


def _dense(path: str | Path, key: str, value: Any, shape: list[int | str]) -> np.ndarray:
    """An array, of a sparse matrix only where it is as large as the spec has it."""
    if isinstance(value, sparray):
        if value.shape != tuple(shape):
            raise InputError(path, key, f"shape {tuple(shape)}", value.shape)
        value = value.toarray()
    if not isinstance(value, np.ndarray):
        raise InputError(path, key, "an array", type(value).__name__)
    return value
