"""Step I for hands and face: fine boxes of (signed distance, ω) that live in wrist and head frames.

A box depends on the part's own coefficients alone, so a moving body only moves it (paper sec. 4, 'refine the hands and
the face'; docs/architecture.md). It is evaluated coarse to fine: voxels half as large get the mean of their neighbours,
and the field only where that is within `REACH` coarse voxels of the surface or a crossing touches them (narrow_band.py).

Letters: z y x voxels, v vertices. Part frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float16
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandField, HandSurface
from avatarrex.templates.mesh import vertex_normals
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import between, halved, settle
from avatarrex.volume.template_distance import TemplateDistance

CLAMP = 0.051
"""Metres: past the deepest value that the composition asks for (paper eq. 13), whatever half precision rounds it to."""
BOUND = (-CLAMP, 0.026)
"""Metres between which hands are asked: both ends outside the band."""
HAND_MARGIN = 0.028
"""Metres of box around the hand: past +0.025 the hand is not blended (paper eq. 13)."""
FACE_BAND = 0.03
"""Metres around the face mesh in which the face field is evaluated and blended: past +0.025 it is not used."""
FACE_REACH = 0.012
"""Metres from the face mesh that are evaluated at the coarse level; the surface is followed from there."""
REACH = 1.0
"""Coarse voxels."""
COARSEST = 4
"""Voxels a side of a lattice that boxes begin with, at most."""


@dataclass(frozen=True)
class PartField:
    """A part's box before it is placed in the root frame."""

    name: str
    origin: np.ndarray
    """Voxel 0's centre in the part frame, (3,) metres."""
    voxel: float
    field: Float16[Tensor, "z y x 2"]
    """Signed distance clamped to ±5.1 cm, and ω; half precision errs by 2e-6 m within 4 mm, by 2e-5 m at the clamp."""
    surface: HandSurface | None = None
    """Of a hand: its posed mesh, prepared for look-ups."""

    def corners(self) -> np.ndarray:
        """(8, 3) part-frame corners of the outermost voxel centres."""
        size = self.voxel * (np.array(self.field.shape[2::-1]) - 1)
        unit = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        return self.origin + unit * size


def part_bounds(vertices: Tensor, blend_weight: Tensor, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates of the vertices (v, 3) whose ω (v,) is not 0, and a margin; metres."""
    mesh = vertices[blend_weight > 0].double().numpy()
    return mesh.min(0) - margin, mesh.max(0) + margin


def _lattice(low: np.ndarray, high: np.ndarray, voxel: float) -> Lattice:
    first = np.floor(low / voxel).astype(int)
    size = np.ceil(high / voxel).astype(int) - first + 1
    return Lattice(first * voxel, voxel, (int(size[2]), int(size[1]), int(size[0])))


def hand_box(
    name: str, field: HandField, vertices: Tensor, voxel: float, counters: Counters, everywhere: bool = False
) -> PartField:
    """The exact distance to the hand mesh (v, 3) and the painted ω of the nearest surface point (paper eq. 8, 9).

    `everywhere`: at every voxel, not only around the surface.
    """
    lattice = _lattice(*part_bounds(vertices, field.blend_weight, HAND_MARGIN), COARSEST * voxel)
    surface = field.surface(vertices)

    def evaluate(lattice: Lattice, index: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            position = torch.as_tensor(lattice.position(index), dtype=torch.float32)
            query = field.sdf(vertices, position, BOUND, surface=surface)
        counters.add("hand_distances", len(index))
        return torch.stack([query.sdf.clamp(-CLAMP, CLAMP), field.omega(query)], -1).numpy()

    values = evaluate(lattice, np.arange(np.prod(lattice.shape))).reshape(*lattice.shape, 2)
    for _ in range(2):
        lattice, values = _refine(lattice, values, evaluate, None, everywhere)
    return PartField(name, lattice.origin, lattice.voxel, torch.from_numpy(values).half(), surface)


def face_box(
    field: FaceField,
    planes: Tensor,
    vertices: Tensor,
    blend_weight: Tensor,
    voxel: float,
    counters: Counters,
    everywhere: bool = False,
) -> PartField:
    """The face field near the face mesh (v, 3), with the ω (v,) painted on it; elsewhere 'not used'.

    `everywhere`: at every voxel that is used, not only around the surface.
    """
    lattice = _lattice(*part_bounds(vertices, blend_weight, FACE_BAND), 2 * voxel)
    here = face_skin(field, vertices, blend_weight).query(lattice.position(np.arange(np.prod(lattice.shape))))
    used = (here.distance < FACE_BAND) & (here.weight > 0)
    guess = np.where(used, here.guess, CLAMP).clip(-CLAMP, CLAMP)
    values = np.stack([guess, np.where(used, here.weight, 0)], -1).astype(np.float32)

    def evaluate(lattice: Lattice, index: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            sdf = field.sdf(planes, torch.as_tensor(lattice.position(index), dtype=torch.float32))
        counters.add("face_evaluations", len(index))
        return sdf.float().clamp(-CLAMP, CLAMP).numpy()[:, None]

    near = np.flatnonzero(used & ((np.abs(guess) < FACE_REACH) | everywhere))
    values[near, :1] = evaluate(lattice, near)
    unused = ~used.reshape(lattice.shape)
    lattice, values = _refine(lattice, values.reshape(*lattice.shape, 2), evaluate, unused, everywhere)
    return PartField("face", lattice.origin, lattice.voxel, torch.from_numpy(values).half())


def face_skin(field: FaceField, vertices: Tensor, blend_weight: Tensor) -> TemplateDistance:
    """Nearest vertices of the posed face mesh (v, 3) and their ω (v,)."""
    mesh, normals = vertices.double().numpy(), vertex_normals(vertices, field.faces).double().numpy()
    return TemplateDistance.of(mesh, normals, blend_weight.double().numpy(), np.zeros(len(mesh)))


def _refine(
    lattice: Lattice,
    values: np.ndarray,
    evaluate: Callable[[Lattice, np.ndarray], np.ndarray],
    unused: np.ndarray | None,
    everywhere: bool,
) -> tuple[Lattice, np.ndarray]:
    """`values` (z, y, x, 2) at half the voxel; `evaluate` gives (p, 1 or 2) channels; `unused` voxels are not asked."""
    fine = halved(lattice)
    values = np.ascontiguousarray(between(values))
    closed = None if unused is None else between(unused.astype(np.float32)) == 1
    near = (np.abs(values[..., 0]) < REACH * lattice.voxel) | everywhere
    flat = values.reshape(-1, 2)

    def at(index: np.ndarray) -> np.ndarray:
        found = evaluate(fine, index)
        flat[index, : found.shape[1]] = found
        return found[:, 0]

    values[..., 0], _ = settle(values[..., 0], np.flatnonzero(near if closed is None else near & ~closed), at, closed)
    return fine, values
