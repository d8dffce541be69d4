"""The albedo texture: the exact colours at every texel, light divided out, mean over some poses.

Letters: v vertices, x texels, h w texture. sRGB-encoded.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float32
from torch.nn.functional import normalize

from avatarrex.distil.exact import ExactPose
from avatarrex.distil.follow import Followed
from avatarrex.distil.texels import Texels

BLOCK = 200_000
"""Texels at a time."""
FAINT = 1e-3
"""Weight of a pose in which a texel's vertices were not found."""


class Bake:
    """Sums colours over poses."""

    def __init__(self, texels: Texels, faces: np.ndarray) -> None:
        self.texels, self.faces = texels, faces
        self.sum = np.zeros((len(texels.face), 3))
        self.weight = np.zeros((len(texels.face), 1))

    @torch.no_grad()
    def add(self, exact: ExactPose, followed: Followed, light: Float32[np.ndarray, "v 3"]) -> None:
        """The colours of one pose; `light` (v, 3) is what an albedo is multiplied by there."""
        share = exact.field(followed.position).part_weight.numpy()
        columns = (
            followed.position.numpy(), followed.normal.numpy(), share, light, followed.found[:, None].numpy().astype(np.float32)
        )  # fmt: skip
        for start in range(0, len(self.sum), BLOCK):
            rows = slice(start, start + BLOCK)
            block = Texels(self.texels.inside, self.texels.face[rows], self.texels.barycentric[rows])
            position, normal, weight, lit, found = (
                torch.as_tensor(block.interpolated(self.faces, column)) for column in columns
            )
            colour = exact.colours.colour(position, -normalize(normal, dim=-1), weight).clamp(0, 1) / lit
            trust = found.clamp_min(FAINT).numpy()
            self.sum[rows] += trust * colour.numpy()
            self.weight[rows] += trust

    def albedo(self) -> Float32[np.ndarray, "x 3"]:
        """Means over the poses so far."""
        return (self.sum / self.weight).astype(np.float32)
