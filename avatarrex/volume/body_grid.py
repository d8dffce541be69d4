"""Step I for the body: its signed distance on a regular grid in the root frame (paper sec. 4, Step I).

The surface stands off the template by at most `CLOTH`, so only voxels within `BAND` of the template are evaluated and the
field is held to that shell; the rest is filled with a distance that never exceeds the true one.

Letters: z y x voxels, p evaluated voxels, v template vertices. Root frame, metres, negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.volume.stencil import Lattice, stencil_pairs
from avatarrex.volume.volume import BodyGrid

MAX_SIDE = 128
"""Voxels along a side (paper sec. 4): the voxel grows rather than a limb being cut off."""
CLOTH = 0.045
"""Metres that the surface may stand off the template; beyond it a fitted field has seen no samples and may hold anything."""
BAND = 0.065
"""Metres around the template that are evaluated: the cloth and a voxel."""
MARGIN = 0.08
"""Metres of box around the template: the band and a voxel."""
BLOCK = 4
"""Voxels along a side of the blocks that are culled whole."""
EMPTY = 0.02
"""Metres: value of the emptied hand region, a voxel (docs/architecture.md)."""


@dataclass(frozen=True)
class TemplateProbe:
    """Nearest-vertex queries on the posed template: distance, side and painted weights of the nearest vertex."""

    vertices: np.ndarray
    normals: np.ndarray
    hand_weight: np.ndarray
    tree: cKDTree

    @staticmethod
    def of(vertices: np.ndarray, normals: np.ndarray, hand_weight: np.ndarray) -> TemplateProbe:
        """(v, 3) vertices and normals, (v,) painted hand weight ω."""
        return TemplateProbe(vertices, normals, hand_weight, cKDTree(vertices))

    def query(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (p,), whether inside (p,), and hand weight (p,) of the nearest vertex to `position` (p, 3)."""
        distance, nearest = self.tree.query(position, workers=-1)
        offset = position - self.vertices[nearest]
        inside = np.einsum("pc,pc->p", offset, self.normals[nearest]) < 0
        return distance, inside, self.hand_weight[nearest]


def empty_hands(sdf: Tensor, hand_weight: Tensor) -> Tensor:
    """The body field without its hands: `s_B ← (1−ω) s_B + ω max(s_B, 2 cm)`; (p,) both."""
    return torch.lerp(sdf, sdf.clamp(min=EMPTY), hand_weight)


def lattice_around(points: np.ndarray, voxel: float) -> Lattice:
    """The lattice at multiples of `voxel` metres that holds `points` (k, 3), at most `MAX_SIDE` voxels a side."""
    low, high = points.min(0), points.max(0)
    while True:
        first = np.floor(low / voxel).astype(int)
        size = np.ceil(high / voxel).astype(int) - first + 1
        if size.max() <= MAX_SIDE:
            return Lattice(first * voxel, voxel, (int(size[2]), int(size[1]), int(size[0])))
        voxel *= 1.001 * max(1.0, (high - low).max() / voxel / (MAX_SIDE - 2))


def build_body_grid(
    field: BodyField, frame: BodyFrame, probe: TemplateProbe, voxel: float, counters: Counters
) -> BodyGrid:
    """Evaluate the body field near the template, on multiples of `voxel` metres in the root frame."""
    lattice = lattice_around(np.concatenate([probe.vertices - MARGIN, probe.vertices + MARGIN]), voxel)
    grid = _evaluate(field, frame, probe, lattice, max(BAND, CLOTH + lattice.voxel), counters)
    return BodyGrid(origin=lattice.origin, voxel=lattice.voxel, sdf=grid)


def _evaluate(
    field: BodyField, frame: BodyFrame, probe: TemplateProbe, lattice: Lattice, band: float, counters: Counters
) -> Tensor:
    """The filled grid (z, y, x)."""
    grid, index = _block_fill(lattice, probe, band)
    position = lattice.position(index)
    distance, inside, hand_weight = probe.query(position)
    near = distance < band
    side = np.where(inside, -1.0, 1.0)
    fill = side * np.maximum(distance - band + lattice.voxel, lattice.voxel)
    pairs = stencil_pairs(frame.node_position, lattice, index[near])
    with torch.no_grad():
        sdf = field.sdf(frame, torch.as_tensor(position[near], dtype=torch.float32), pairs)
    counters.add("voxels_evaluated", int(near.sum()))
    counters.add("local_mlp_evaluations", len(pairs.point))
    beyond = torch.as_tensor(np.where(inside, -np.inf, distance - CLOTH)[near], dtype=torch.float32)
    sdf = torch.maximum(sdf, beyond)
    flat = grid.view(-1)
    flat[torch.from_numpy(index)] = torch.as_tensor(fill, dtype=torch.float32)
    flat[torch.from_numpy(index[near])] = empty_hands(sdf, torch.as_tensor(hand_weight[near], dtype=torch.float32))
    return grid


def _block_fill(lattice: Lattice, probe: TemplateProbe, band: float) -> tuple[Tensor, np.ndarray]:
    """A grid filled block by block, and the flat indices of the voxels in blocks that reach into the band.

    A block centre at distance d with block radius r says that every voxel in it is at least d − r from the template, and
    the surface lies at most band − voxel from the template: the fill d − r − band + voxel never exceeds the distance.
    """
    shape = lattice.shape
    blocks = tuple(-(-side // BLOCK) for side in shape)
    z, y, x = np.meshgrid(*(np.arange(side) for side in blocks), indexing="ij")
    corner = np.stack([x, y, z], -1).reshape(-1, 3) * BLOCK
    centre = lattice.origin + lattice.voxel * (corner + (BLOCK - 1) / 2)
    distance, inside, _ = probe.query(centre)
    radius = np.sqrt(3) * lattice.voxel * (BLOCK - 1) / 2
    fill = np.where(inside, -1.0, 1.0) * np.maximum(distance - radius - band + lattice.voxel, lattice.voxel)
    near = (distance < band + radius).reshape(blocks)
    coarse = torch.as_tensor(fill.reshape(blocks), dtype=torch.float32)
    grid = coarse
    for axis in range(3):
        grid = grid.repeat_interleave(BLOCK, axis)
    grid = grid[: shape[0], : shape[1], : shape[2]].contiguous()
    mask = near
    for axis in range(3):
        mask = mask.repeat(BLOCK, axis)
    return grid, np.flatnonzero(mask[: shape[0], : shape[1], : shape[2]])
