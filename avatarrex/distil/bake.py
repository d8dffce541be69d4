"""The albedo texture: the exact colours at every texel, light divided out, mean over poses in which the texel is found.

Letters: v vertices, x texels, h w texture. sRGB-encoded.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.distil.exact import ExactPose
from avatarrex.distil.follow import Followed
from avatarrex.distil.texels import Texels

BLOCK = 200_000
"""Texels at a time."""
FAINT = 1e-3
"""Weight of a pose in which a texel's vertices were not found."""


class Bake:
    """Sums colours over poses, at texels and at vertices."""

    def __init__(self, texels: Texels, faces: np.ndarray, vertices: int) -> None:
        self.texels, self.faces = texels, faces
        self.texel_sum, self.vertex_sum = np.zeros((len(texels.face), 4)), np.zeros((vertices, 4))

    @torch.no_grad()
    def add(
        self, exact: ExactPose, followed: Followed, light: Float[Tensor, "v 3"], weight: Float[Tensor, " v"]
    ) -> None:
        """The colours of one pose, of that weight at each vertex; `light` (v, 3) is what an albedo is multiplied by there.

        Texels of triangles without any weight are not computed.
        """
        share = exact.field(followed.position).part_weight.numpy()
        trust = weight[:, None] * followed.found[:, None].float().clamp_min(FAINT)
        at_vertex = exact.colour(followed.position, -followed.normal) / light
        self.vertex_sum += torch.cat([trust * at_vertex, trust], 1).numpy()
        columns = (followed.position.numpy(), followed.normal.numpy(), share, light.numpy(), trust.numpy())
        counted = np.flatnonzero((weight.numpy()[self.faces] > 0).any(1)[self.texels.face])
        for rows in np.array_split(counted, len(counted) // BLOCK + 1):
            block = Texels(self.texels.inside, self.texels.face[rows], self.texels.barycentric[rows])
            position, normal, part_weight, lit, trusted = (
                torch.as_tensor(block.interpolated(self.faces, column)) for column in columns
            )
            colour = exact.colours.colour(position, -normalize(normal, dim=-1), part_weight).clamp(0, 1) / lit
            self.texel_sum[rows] += torch.cat([trusted * colour, trusted], 1).numpy()

    def texels_and_vertices(self) -> tuple[Float[np.ndarray, "x 3"], Float[np.ndarray, "v 3"]]:
        """Weighted means over the poses so far."""
        texel, vertex = (sums[:, :3] / sums[:, 3:] for sums in (self.texel_sum, self.vertex_sum))
        return texel, vertex
