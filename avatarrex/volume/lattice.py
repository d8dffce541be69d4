"""A regular grid of voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Lattice:
    """Voxel (z, y, x) sits at origin + voxel · (x, y, z)."""

    origin: np.ndarray
    """Position of voxel 0, (3,) metres."""
    voxel: float
    shape: tuple[int, int, int]
    """Voxels along z, y, x."""

    def corners(self) -> np.ndarray:
        """(8, 3) positions of the outermost voxels."""
        size = self.voxel * (np.array(self.shape[::-1]) - 1)
        unit = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        return self.origin + unit * size

    def position(self, index: np.ndarray) -> np.ndarray:
        """(p,) flat indices -> (p, 3) float64 positions."""
        z, y, x = np.unravel_index(index, self.shape)
        return np.asarray(self.origin + self.voxel * np.stack([x, y, z], -1))
