"""What stands off the template farther than cloth does: a pony tail, a bun, a hood. Ours.

A signed distance at rest, carved from the mattes of the training pictures (training/core/carving.py). It is not the surface:
where it is nearer than the skin it is the guess that the body's field deviates from (template_distance.py). A posed point is
taken to rest by the rigid motion of the joint that it hangs on or, where the carving found none, of its nearest template vertex.
Stored on a regular grid about what was found. What hangs on a joint has anchors of its own on its surface (local_frame.py): by those of
the skin next to it, the end of a pony tail at the back, rest positions were up to 8 cm off, and not the same in two poses.

Letters: z y x voxels, v vertices, p points. Metres, negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_erosion, map_coordinates
from scipy.spatial import cKDTree
from torch import Tensor, nn

from avatarrex.ops.farthest_points import farthest_points

VOXEL = 0.008
"""Metres: two pixels of a whole person at 512²."""
REACH = 0.13
"""Metres from the template within which a hull is looked for."""
DEVIATION = 0.03
"""Metres that the field may differ from the carved hull, which is as exact as some outlines are."""
MARGIN = 0.1
"""Metres of grid around the hull, and the distance beyond it."""


class Outgrowth(nn.Module):
    """A grid of distances at rest; it knows what carries it from `lay` on."""

    first: Tensor
    """(3,) whole voxels from the root to the grid's lowest corner: x, y, z."""
    distance: Tensor
    """(z, y, x)."""
    joint: Tensor | None
    """Number of the joint that it hangs on; None: the vertices beneath it carry it."""
    anchor: Tensor | None
    """(o, 3) anchors on its surface at rest; None where no joint carries it, and in avatars of before."""

    def __init__(
        self,
        first: Int[Tensor, " 3"],
        distance: Float[Tensor, "z y x"],
        joint: Int[Tensor, ""] | None = None,
        anchor: Float[Tensor, "o 3"] | None = None,
    ) -> None:
        super().__init__()
        self.register_buffer("first", first)
        self.register_buffer("distance", distance)
        self.register_buffer("joint", joint)
        self.register_buffer("anchor", anchor)
        self.carrier = np.zeros(0, np.int64)
        """(c,) vertices that a point next to the outgrowth may have as its nearest."""

    def lay(self, rest: Float[Tensor, "v 3"]) -> None:
        """Let the template at rest be these vertices."""
        self._rest = rest.double().numpy()
        points = self.points()
        self.carrier = np.flatnonzero(cKDTree(points).query(self._rest, distance_upper_bound=2 * REACH)[0] < np.inf)
        self._nearest = cKDTree(self._rest[self.carrier]).query(points)[1]

    def points(self) -> Float[np.ndarray, "p 3"]:
        """Centres of the voxels inside, root frame at rest."""
        inside = np.argwhere(self.distance.numpy() <= 0)[:, ::-1]
        return np.asarray((inside + self.first.numpy()) * VOXEL)

    def hanging_on(self, joint: int, spacing: float) -> Outgrowth:
        """The same on a joint, with anchors so many metres apart."""
        anchor = torch.from_numpy(self.surface_points(spacing)).float()
        return Outgrowth(self.first, self.distance, torch.tensor(joint), anchor)

    def outward(self, place: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Unit directions in which the distance grows at rest."""
        steps = VOXEL * np.concatenate([np.eye(3), -np.eye(3)])
        ahead, behind = self._distance(place[:, None] + steps).reshape(len(place), 2, 3).transpose(1, 0, 2)
        return np.asarray((ahead - behind) / np.linalg.norm(ahead - behind, axis=1, keepdims=True).clip(1e-12))

    def surface_points(self, spacing: float) -> Float[np.ndarray, "o 3"]:
        """Points on its surface at rest, about `spacing` metres apart."""
        inside = self.distance.numpy() <= 0
        outermost = np.argwhere(inside & ~binary_erosion(inside))[:, ::-1]
        place = (outermost + self.first.numpy()) * VOXEL
        place = place - self._distance(place)[:, None] * self.outward(place)
        count = int(np.ceil(len(place) * (VOXEL / spacing) ** 2))
        return np.asarray(place[farthest_points(torch.from_numpy(place), count, 0).numpy()])

    def _distance(self, place: Float[np.ndarray, "*p 3"]) -> Float[np.ndarray, "*p"]:
        found = _in_grid(self.distance.double().numpy(), self.first.numpy() * VOXEL, place.reshape(-1, 3))
        return found.reshape(place.shape[:-1])

    def carried(self, posed: Float[np.ndarray, "v 3"], turn: Float[np.ndarray, "c 3 3"]) -> PosedOutgrowth:
        """On a template whose vertices are now `posed`, and whose carriers were turned by `turn`."""
        slot = np.full(len(posed), -1)
        slot[self.carrier] = np.arange(len(self.carrier))
        rest, place, by = self._rest[self.carrier], posed[self.carrier], self._nearest
        points = place[by] + np.einsum("pij,pj->pi", turn[by], self.points() - rest[by])
        grid = np.ascontiguousarray(self.distance.double().numpy())
        return PosedOutgrowth(grid, self.first.numpy() * VOXEL, slot, rest, place, turn, points)

    def hung(self, vertices: int, rest_to_posed: Float[np.ndarray, "4 4"]) -> PosedOutgrowth:
        """On a template of so many vertices, moved as its joint is."""
        slot = np.full(vertices, -1)
        slot[self.carrier] = 0
        turn, shift = rest_to_posed[:3, :3], rest_to_posed[:3, 3]
        grid = np.ascontiguousarray(self.distance.double().numpy())
        points, one = self.points() @ turn.T + shift, np.zeros((1, 3))
        return PosedOutgrowth(grid, self.first.numpy() * VOXEL, slot, one, shift[None], turn[None], points)


@dataclass(frozen=True, eq=False)
class PosedOutgrowth:
    """An outgrowth in a pose."""

    grid: Float[np.ndarray, "z y x"]
    origin: Float[np.ndarray, "3"]
    slot: Int[np.ndarray, " v"]
    """Which carrier each vertex of the template is; −1: none."""
    rest: Float[np.ndarray, "c 3"]
    posed: Float[np.ndarray, "c 3"]
    turn: Float[np.ndarray, "c 3 3"]
    points: Float[np.ndarray, "p 3"]
    """Its voxels in the pose."""

    def distance(self, position: Float[np.ndarray, "p 3"], nearest: Int[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Of posed points with their nearest vertices; ∞ where none of these carries it."""
        found = np.full(len(position), np.inf)
        rows = np.flatnonzero(self.slot[nearest] >= 0)
        if len(rows):
            by = self.slot[nearest[rows]]
            back = np.einsum("pji,pj->pi", self.turn[by], position[rows] - self.posed[by]) + self.rest[by]
            found[rows] = _in_grid(self.grid, self.origin, back)
        return found

    def of_vertices(self, chosen: Bool[np.ndarray, " v"]) -> PosedOutgrowth:
        """Of a template that has these vertices alone."""
        return replace(self, slot=self.slot[chosen])


def _in_grid(
    grid: Float[np.ndarray, "z y x"], origin: Float[np.ndarray, "3"], place: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, " p"]:
    """Interpolated distances at rest positions; `MARGIN` outside the grid, whose lowest voxel is at `origin`."""
    voxel = (place - origin) / VOXEL
    return np.asarray(map_coordinates(grid, voxel[:, ::-1].T, order=1, cval=MARGIN, prefilter=False))
