"""How far each level's depth is from the exact frame's: measured figures, kept as data (data/level_errors.json).

An entry is `{"depth_mean_mm": …, "depth_p99_mm": …}`, against the dense float64 frame, or null where none was measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from avatarrex.errors import InputError
from avatarrex.files.json_text import SMALL, read_json

PATH = Path(__file__).parents[1] / "data" / "level_errors.json"


@dataclass(frozen=True)
class LevelError:
    """Depth error along the camera's axis, millimetres."""

    depth_mean_mm: float
    depth_p99_mm: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
                raise InputError(PATH, name, "millimetres", value)


@cache
def level_errors(path: Path = PATH) -> dict[str, LevelError | None]:
    """The error of every level by name; None where it was not measured. Raises `InputError`."""
    data = read_json(path, "the errors of the levels", SMALL)
    if not isinstance(data, dict):
        raise InputError(path, "", "an object", type(data).__name__)
    return {name: None if entry is None else _read(path, name, entry) for name, entry in data.items()}


def _read(path: Path, name: str, entry: Any) -> LevelError:
    try:
        return LevelError(**entry)
    except TypeError:
        raise InputError(path, name, "depth_mean_mm and depth_p99_mm", entry) from None
