"""Packaged data, and `.npz` files read without unpickling."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError

DATA = Path(__file__).parent / "data"


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Every array of an `.npz` file. Raises `InputError` for a missing, truncated or pickled file."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "an .npz file", "nothing there")
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise InputError(path, "", "a complete .npz file", error) from None
    except ValueError as error:
        raise InputError(path, "", "an .npz file of plain arrays (no pickled objects)", error) from None


def require(arrays: dict[str, np.ndarray], source: str | Path, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """`arrays[key]`, checked: present, of `shape` (None admits any length), finite."""
    if key not in arrays:
        raise InputError(source, key, "the key to be there", f"only {', '.join(sorted(arrays)[:12])}")
    value = arrays[key]
    fits = value.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, value.shape))
    if not fits:
        wanted = "(" + ", ".join("any" if side is None else str(side) for side in shape) + ")"
        raise InputError(source, key, f"shape {wanted}", value.shape)
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        raise InputError(source, key, "finite numbers", f"{int((~np.isfinite(value)).sum())} NaN or Inf")
    return value
