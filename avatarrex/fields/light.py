"""The light that a person stands in, as far as it depends on the way its surface is turned.

    c = c_net · E(n),    E(n) = 1 + Σ_k h_k Y_k(n)

Ours. The paper's colours know pose and view alone: a limb that is turned as in no training picture keeps the light of where it
hung. Diffuse light is smooth in the normal: nine harmonics have 99 % of it (Ramamoorthi and Hanrahan 2001), so that eight
numbers a channel serve the whole person. n is where the body's anchors, or the hand's mesh, face in the root frame: it turns
with the limb and is smooth; what is finer stays in c_net. The face has its tone mapping. E = 1 until it is trained.

Letters: p points.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

DARKEST = 0.1
"""Least E: beyond what was seen the harmonics may go below zero."""


class Light(nn.Module):
    """Eight harmonics of three channels."""

    def __init__(self) -> None:
        super().__init__()
        self.harmonics = nn.Parameter(torch.zeros(8, 3))

    def forward(self, normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """E of unit normals in the root frame."""
        return (1 + self.basis(normal) @ self.harmonics).clamp_min(DARKEST)

    @staticmethod
    def basis(normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 8"]:
        """Y of unit normals."""
        x, y, z = normal.unbind(-1)
        return torch.stack([x, y, z, x * y, y * z, z * x, (3 * z * z - 1) / 2, (x * x - y * y) / 2], -1)
