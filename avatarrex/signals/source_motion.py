"""A file's skeleton and where it goes, whatever the format: what retarget.py starts from. Letters: t frames, j joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

END = " end"
"""Suffix of the name that an end site gets from its joint; no joint's name ends so, as names are stripped."""


@dataclass(frozen=True, eq=False)
class SourceMotion:
    """In the file's own axes and unit. End sites are joints that never turn: they tell where the last bone points."""

    dialect: str
    """The kind of file."""
    names: tuple[str, ...]
    parents: np.ndarray
    """(j,) the root's is −1; a parent stands before its children."""
    offsets: np.ndarray
    """(j, 3) from the parent at rest."""
    turned: np.ndarray
    """(t, j, 3, 3) global rotations, the identity at rest."""
    places: np.ndarray
    """(t, j, 3) positions."""
    fps: float

    @property
    def rest(self) -> np.ndarray:
        """(j, 3) positions at rest."""
        rest = np.zeros_like(self.offsets)
        for k, parent in enumerate(self.parents):
            rest[k] = self.offsets[k] + (rest[parent] if parent >= 0 else 0)
        return rest
