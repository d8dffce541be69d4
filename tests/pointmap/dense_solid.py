"""A solid with a closed form (reference/solids.py) as what dense rays are cast against and hits are polished onto."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from avatarrex.fields.composition import Composed
from avatarrex.reference.solids import Solid


@dataclass(frozen=True)
class DenseSolid:
    """`solid` within 1 m of the origin."""

    solid: Solid

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return -np.ones(3), np.ones(3)

    def sdf(self, position: Tensor) -> Tensor:
        return self.solid(position)

    def clearance(self, position: Tensor) -> Tensor:
        """Nothing is promised within 5 cm, half the distance beyond."""
        sdf = self.solid(position)
        return torch.where(sdf > 0.05, sdf / 2, 0.0)

    def __call__(self, position: Tensor) -> Composed:
        return Composed(self.solid(position), position.new_zeros(len(position), 3))
