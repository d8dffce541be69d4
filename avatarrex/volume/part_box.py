"""Step I for hands and face: fine boxes of (signed distance, ω) that live in wrist and head frames.

A box depends on the part's own coefficients alone, so a moving body only moves it (paper sec. 4, 'refine the hands and
the face'; docs/architecture.md). Letters: z y x voxels, v vertices. Part frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandField
from avatarrex.volume.stencil import Lattice

CLAMP = 0.05
"""Metres: the deepest value that the composition asks for (paper eq. 13)."""
HAND_MARGIN = 0.028
"""Metres of box around the hand: past +0.025 the hand is not blended (paper eq. 13)."""
FACE_BAND = 0.03
"""Metres around the face mesh in which the face field is evaluated and blended: past +0.025 it is not used."""


@dataclass(frozen=True)
class PartField:
    """A part's box before it is placed in the root frame."""

    name: str
    origin: np.ndarray
    """Voxel 0's centre in the part frame, (3,) metres."""
    voxel: float
    field: Float32[Tensor, "z y x 2"]
    """Signed distance clamped to ±5 cm, and ω."""

    def corners(self) -> np.ndarray:
        """(8, 3) part-frame corners of the outermost voxel centres."""
        size = self.voxel * (np.array(self.field.shape[2::-1]) - 1)
        unit = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        return self.origin + unit * size


def _lattice(points: np.ndarray, margin: float, voxel: float) -> Lattice:
    first = np.floor((points.min(0) - margin) / voxel).astype(int)
    size = np.ceil((points.max(0) + margin) / voxel).astype(int) - first + 1
    return Lattice(first * voxel, voxel, (int(size[2]), int(size[1]), int(size[0])))


def hand_box(name: str, field: HandField, vertices: Tensor, voxel: float, counters: Counters) -> PartField:
    """The exact distance to the hand mesh (v, 3) and the painted ω of the nearest surface point (paper eq. 8, 9)."""
    weight = field.blend_weight
    lattice = _lattice(vertices[weight > 0].double().numpy(), HAND_MARGIN, voxel)
    count = int(np.prod(lattice.shape))
    points = torch.as_tensor(lattice.position(np.arange(count)), dtype=torch.float32)
    with torch.no_grad():
        query = field.sdf(vertices, points)
        omega = (weight[field.faces[query.face]] * query.barycentric).sum(-1)
    counters.add("hand_distances", count)
    values = torch.stack([query.sdf.clamp(-CLAMP, CLAMP), omega], -1)
    return PartField(name, lattice.origin, voxel, values.float().reshape(*lattice.shape, 2))


def face_box(
    field: FaceField, planes: Tensor, vertices: Tensor, blend_weight: Tensor, voxel: float, counters: Counters
) -> PartField:
    """The face field near the face mesh (v, 3), with the ω (v,) of the nearest vertex; elsewhere 'not used'."""
    tree = cKDTree(vertices.double().numpy())
    lattice = _lattice(vertices[blend_weight > 0].double().numpy(), FACE_BAND, voxel)
    count = int(np.prod(lattice.shape))
    position = lattice.position(np.arange(count))
    distance, nearest = tree.query(position, distance_upper_bound=FACE_BAND, workers=-1)
    near = np.flatnonzero(np.isfinite(distance))
    omega = torch.zeros(count)
    omega[torch.from_numpy(near)] = blend_weight[torch.from_numpy(nearest[near])].float()
    wanted = torch.nonzero(omega > 0)[:, 0]
    sdf = torch.full((count,), CLAMP)
    with torch.no_grad():
        values = field.sdf(planes, torch.as_tensor(position, dtype=torch.float32)[wanted])
    sdf[wanted] = values.float().clamp(-CLAMP, CLAMP)
    counters.add("face_evaluations", len(wanted))
    return PartField("face", lattice.origin, voxel, torch.stack([sdf, omega], -1).reshape(*lattice.shape, 2))
