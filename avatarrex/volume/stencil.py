"""Which voxels each node reaches, by integer stencils (design: building the pairs by all distances costs twice the MLPs).

Letters: n nodes, p listed voxels, k (voxel, node) pairs. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from avatarrex.fields.influence import RADIUS, Pairs


@dataclass(frozen=True)
class Lattice:
    """A regular grid: voxel (z, y, x) sits at origin + voxel · (x, y, z)."""

    origin: np.ndarray
    """Position of voxel 0, (3,) metres."""
    voxel: float
    shape: tuple[int, int, int]
    """Voxels along z, y, x."""

    def position(self, index: np.ndarray) -> np.ndarray:
        """(p,) flat indices -> (p, 3) float64 positions."""
        z, y, x = np.unravel_index(index, self.shape)
        return self.origin + self.voxel * np.stack([x, y, z], -1)


def stencil_pairs(node_position: Tensor, lattice: Lattice, index: np.ndarray) -> Pairs:
    """Pairs (voxel, node) within the nodes' influence radius, sorted by node.

    `node_position` (n, 3), `index` (p,) flat voxel indices; a pair's point is the row in `index`.
    """
    row = np.full(lattice.shape, -1, dtype=np.int32)
    row.reshape(-1)[index] = np.arange(len(index), dtype=np.int32)
    points, counts = [], []
    for node in node_position.double().numpy():
        grid_node = (node - lattice.origin) / lattice.voxel
        reach = RADIUS / lattice.voxel
        axes, squares = [], []
        for axis, side in ((2, lattice.shape[0]), (1, lattice.shape[1]), (0, lattice.shape[2])):
            low = max(int(np.ceil(grid_node[axis] - reach)), 0)
            high = min(int(np.floor(grid_node[axis] + reach)), side - 1)
            axes.append(slice(low, high + 1))
            squares.append((np.arange(low, high + 1) - grid_node[axis]) ** 2)
        rows = row[axes[0], axes[1], axes[2]]
        squared = squares[0][:, None, None] + squares[1][:, None] + squares[2]
        found = rows[(squared < reach * reach) & (rows >= 0)]
        points.append(found)
        counts.append(len(found))
    offsets = torch.zeros(len(counts) + 1, dtype=torch.int64)
    offsets[1:] = torch.cumsum(torch.tensor(counts), 0)
    node_of_pair = torch.repeat_interleave(torch.arange(len(counts)), torch.tensor(counts))
    point = torch.from_numpy(np.concatenate(points).astype(np.int64)) if points else torch.zeros(0, dtype=torch.int64)
    return Pairs(point=point, node=node_of_pair, offsets=offsets)


def stencil_pairs_reference(node_position: Tensor, lattice: Lattice, index: np.ndarray) -> Pairs:
    """The same by all distances, float64."""
    position = torch.from_numpy(lattice.position(index))
    reached = torch.cdist(node_position.double(), position) < RADIUS
    node, point = torch.nonzero(reached, as_tuple=True)
    offsets = torch.zeros(len(node_position) + 1, dtype=torch.int64)
    offsets[1:] = torch.cumsum(reached.sum(1), 0)
    return Pairs(point=point, node=node, offsets=offsets)
