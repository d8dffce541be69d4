"""The albedo texture: the exact colours at every texel, light divided out, the median over poses in which the texel is found.

A mean would keep a trace of every pose that folds a hem or whose pattern was lost.

Letters: n poses, v vertices, x texels, i texels or vertices. sRGB-encoded.
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
SURE = 0.5
"""Weight from which a pose counts for the median; where none has it, the weighted mean is taken."""


class Colours:
    """Colours of the same places in several poses."""

    def __init__(self, count: int) -> None:
        self.sum = np.zeros((count, 4))
        self.sure: list[Float[np.ndarray, "i 3"]] = []
        """Of each pose, in half precision; infinite where it is not sure."""

    def add(self, rows: np.ndarray, found: Float[np.ndarray, "n 4"]) -> None:
        """One pose: colour and weight of the places `rows`."""
        weight = found[:, 3:]
        self.sum[rows] += np.concatenate([weight * found[:, :3], weight], 1)
        sure = np.full((len(self.sum), 3), np.inf, np.float16)
        sure[rows] = np.where(weight > SURE, found[:, :3], np.inf)
        self.sure.append(sure)

    def merged(self) -> Float[np.ndarray, "i 3"]:
        """The median of what is sure, and the weighted mean where nothing is."""
        merged = self.sum[:, :3] / self.sum[:, 3:]
        for rows in np.array_split(np.arange(len(merged)), len(merged) // BLOCK + 1):
            ordered = np.sort(np.stack([one[rows] for one in self.sure]), 0)
            count = np.isfinite(ordered[..., 0]).sum(0)
            low, high = (
                np.take_along_axis(ordered, np.maximum(at, 0)[None, :, None], 0)[0].astype(np.float64)
                for at in ((count - 1) // 2, np.minimum(count // 2, count - 1))
            )
            merged[rows] = np.where(count[:, None] > 0, (low + high) / 2, merged[rows])
        return merged


class Bake:
    """Gathers colours over poses, at texels and at vertices."""

    def __init__(self, texels: Texels, faces: np.ndarray, vertices: int) -> None:
        self.texels, self.faces = texels, faces
        self.at_texels, self.at_vertices = Colours(len(texels.face)), Colours(vertices)

    @torch.no_grad()
    def add(
        self, exact: ExactPose, followed: Followed, light: Float[Tensor, "v 3"], weight: Float[Tensor, " v"]
    ) -> None:
        """The colours of one pose, of that weight at each vertex; `light` (v, 3) is what an albedo is multiplied by there.

        Texels of triangles without any weight are not computed.
        """
        share = exact.field(followed.position).part_weight.numpy()
        trust = weight[:, None] * followed.found[:, None].float().clamp_min(FAINT)
        at_vertex = exact.colour(followed.position, followed.gaze) / light
        self.at_vertices.add(np.arange(len(trust)), torch.cat([at_vertex, trust], 1).numpy())
        columns = (followed.position.numpy(), followed.gaze.numpy(), share, light.numpy(), trust.numpy())
        counted = np.flatnonzero((weight.numpy()[self.faces] > 0).any(1)[self.texels.face])
        found = np.zeros((len(counted), 4), np.float32)
        for own in np.array_split(np.arange(len(counted)), len(counted) // BLOCK + 1):
            rows = counted[own]
            block = Texels(self.texels.inside, self.texels.face[rows], self.texels.barycentric[rows])
            position, gaze, part_weight, lit, trusted = (
                torch.as_tensor(block.interpolated(self.faces, column)) for column in columns
            )
            colour = exact.colours.colour(position, normalize(gaze, dim=-1), part_weight).clamp(0, 1) / lit
            found[own] = torch.cat([colour, trusted], 1).numpy()
        self.at_texels.add(counted, found)

    def texels_and_vertices(self) -> tuple[Float[np.ndarray, "x 3"], Float[np.ndarray, "v 3"]]:
        """Medians over the poses so far."""
        return self.at_texels.merged(), self.at_vertices.merged()
