"""A volume's distances made whole: what is stored far from the surface is a lower bound, and soft shadows need the distance.

The body grid is exact in a narrow band alone (volume/body_grid.py): a block of voxels that was culled 10 cm from the skin
may store 2 cm, and a cone as wide as a soft light would be dark there. Here every voxel q near the surface gives the point
q − s ∇s of it, and each voxel of the lattice its distance to the point of the nearest such voxel; the sign is the stored one.

Letters: z y x voxels, p listed voxels. Root frame, metres, negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from avatarrex.ops.trilinear import trilinear
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.sdf_volume import SdfVolume, distance

NEAR = 0.95
"""Voxels from the surface within which a voxel gives a point of it: what is farther may be a bound (`SLACK`), and half a
cell's diagonal is less."""
FARTHEST = 10.0
"""Metres: what an empty volume stores."""
_made: WeakKeyDictionary[SdfVolume, DistanceGrid] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Distances on a regular grid."""

    origin: Float[np.ndarray, "3"]
    """Position of voxel 0."""
    voxel: float
    values: Float[Tensor, "z y x"]

    def sample(self, position: Float[Tensor, "*p 3"]) -> Float[Tensor, "*p"]:
        """Trilinear; outside the grid the value at the nearest border point plus the distance to it."""
        place = (position.reshape(-1, 3) - torch.as_tensor(self.origin).to(position)) / self.voxel
        last = torch.tensor(self.values.shape).flip(0).to(position) - 1
        within = place.clamp(min=torch.zeros_like(last), max=last)
        found = trilinear(self.values[..., None].to(position), within)[:, 0]
        away: Tensor = found + self.voxel * (place - within).norm(dim=-1)
        return away.reshape(position.shape[:-1])


def distance_grid(volume: SdfVolume) -> DistanceGrid:
    """The distances of `volume`, composed of body and parts, on the lattice of its body; made once for a volume."""
    if volume not in _made:
        _made[volume] = _distance_grid(volume)
    return _made[volume]


def _distance_grid(volume: SdfVolume) -> DistanceGrid:
    body = volume.body
    shape = tuple(body.sdf.shape)
    lattice = Lattice(body.origin, body.voxel, (shape[0], shape[1], shape[2]))
    every = torch.from_numpy(lattice.position(np.arange(body.sdf.numel())))
    told = np.ones(body.sdf.numel(), bool) if body.known is None else body.known.ravel().copy()
    for part in volume.parts:
        told |= part.holds(every).numpy()
    signed = body.sdf.numpy().astype(np.float64).ravel()
    rows = np.flatnonzero(told)
    signed[rows] = distance(volume, every[rows]).numpy()
    near = rows[np.abs(signed[rows]) < NEAR * body.voxel]
    if not len(near):
        return DistanceGrid(body.origin, body.voxel, torch.full(shape, FARTHEST))
    foot = _feet(volume, every[near], torch.from_numpy(signed[near])).numpy()
    free = np.ones(shape, bool)
    free.ravel()[near] = False
    z, y, x = distance_transform_edt(free, return_distances=False, return_indices=True).reshape(3, -1)
    number = np.zeros(shape, np.int64)
    number.ravel()[near] = np.arange(len(near))
    away = np.linalg.norm(every.numpy() - foot[number[z, y, x]], axis=1)
    values = np.where(signed < 0, -away, away).astype(np.float32).reshape(shape)
    return DistanceGrid(body.origin, body.voxel, torch.from_numpy(values))


def _feet(volume: SdfVolume, position: Tensor, signed: Tensor) -> Tensor:
    """(p, 3): the surface's points nearest to (p, 3), by the slope of the field there."""
    step = 0.25 * volume.body.voxel
    slope = torch.zeros_like(position)
    for axis in range(3):
        offset = torch.zeros(3, dtype=position.dtype)
        offset[axis] = step
        slope[:, axis] = distance(volume, position + offset) - distance(volume, position - offset)
    return position - signed[:, None] * torch.nn.functional.normalize(slope, dim=-1)
