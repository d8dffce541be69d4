"""The hand poses of SMPL-X and MANO files: principal components and a mean, both in rotation vectors of 15 joints.

    φ = coefficients · components + mean        (the mean is added to rotation vectors, not to rotations)

`flat`: zero is the flat hand, and no mean is added. Libraries differ in what they take for granted, and files seldom say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from avatarrex.errors import InputError


@dataclass(frozen=True, eq=False)
class HandSpace:
    """Of one hand."""

    components: Float[np.ndarray, "45 45"]
    """A component a row, the most important first."""
    mean: Float[np.ndarray, "45"]

    def from_components(self, coefficients: Float[np.ndarray, " n"], flat: bool) -> Float[np.ndarray, "15 3"]:
        """Rotation vectors of the first n coefficients, at most 45. Raises `InputError`."""
        count = len(coefficients)
        if count > len(self.components):
            raise InputError("hand pose", "", f"at most {len(self.components)} components", count)
        return self.from_rotvecs(np.asarray(coefficients, np.float64) @ self.components[:count], flat)

    def from_rotvecs(self, rotvecs: Float[np.ndarray, "..."], flat: bool) -> Float[np.ndarray, "15 3"]:
        """Rotation vectors of a hand that are stored as such: (15, 3) or (45,)."""
        return np.asarray(rotvecs, np.float64).reshape(15, 3) + (0 if flat else self.mean.reshape(15, 3))
