"""The avatar's shape of one frame: a coarse body grid and fine boxes for hands and face (paper sec. 4, Step I).

Letters: z y x voxels, p points. Root frame, metres, negative inside. Storage is what the builder chose (float32, or half:
an SDF error of 8e-6 m); every ray caster reads the same stored numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from torch import Tensor

PARTS = ("left_hand", "right_hand", "face")
"""Order of part weights everywhere."""


@dataclass(frozen=True, eq=False)
class BodyGrid:
    """The body field on a regular grid."""

    origin: Float[np.ndarray, "3"]
    """Root-frame position of voxel 0's centre, float64 metres."""
    voxel: float
    sdf: Float[Tensor, "z y x"]


@dataclass(frozen=True, eq=False)
class Contact:
    """The body field around a part, split into the nodes near the part along the surface and all others."""

    first: Int[np.ndarray, "3"]
    """Index (z, y, x) into the body lattice of the block's first voxel."""
    field: Float[Tensor, "z y x 2"]
    """(own, others)."""


@dataclass(frozen=True, eq=False)
class PartBox:
    """A fine box in the frame of a wrist or the head."""

    name: str
    """One of `PARTS`."""
    box_from_root: Float[np.ndarray, "4 4"]
    """Rigid, root metres to box metres; voxel 0's centre at 0."""
    voxel: float
    field: Float[Tensor, "z y x 2"]
    """(s_part clamped to [-0.05, 0.05], ω)."""
    contact: Contact | None = None

    @property
    def size(self) -> np.ndarray:
        """Metres (x, y, z) between the centres of the outermost voxels."""
        return self.voxel * (np.array(self.field.shape[2::-1]) - 1.0)


@dataclass(frozen=True, eq=False)
class SdfVolume:
    """What rays are cast against."""

    body: BodyGrid
    parts: tuple[PartBox, ...] = ()
