"""Pixels in which the surface hides a farther part of itself: two sheets are seen there, and their colours are mixed.

A sheet ends where depth jumps, or falls away as steeply: close up, the rim of a limb counts as one, too, and its colours are smoothed.

At a silhouette the other sheet is the background, and coverage says how much of the pixel is left to it. At an occlusion edge it is the
surface of a neighbouring pixel, whose colour is at hand once pixels are shaded.

Letters: e such pixels, h w image.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

SHEET_GAP = 4.0
"""Pixel widths between the hits of two neighbours from which they are on two sheets: a plane would lean 76° away."""
NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""Columns and rows to the pixels whose sheets are looked at; as in shaders/pointmap/rays.glsl."""


@dataclass(frozen=True, eq=False)
class OcclusionEdges:
    """Where another sheet covers a part of a pixel whose centre is hit."""

    pixel: Int[Tensor, " e"]
    """Row · width + column."""
    beside: Int[Tensor, " e"]
    """The neighbouring pixel whose centre shows the other sheet."""
    share: Float[Tensor, " e"]
    """Of the pixel's covered sub-positions that show it, more than 0."""

    @classmethod
    def none(cls) -> OcclusionEdges:
        """Of a ray caster that looks for none."""
        return cls(torch.zeros(0, dtype=torch.int64), torch.zeros(0, dtype=torch.int64), torch.zeros(0))

    def among(self, wanted: Bool[Tensor, "h w"]) -> OcclusionEdges:
        """Those in `wanted` pixels."""
        rows = torch.nonzero(wanted.flatten()[self.pixel])[:, 0]
        return OcclusionEdges(self.pixel[rows], self.beside[rows], self.share[rows])

    def joined(self, others: OcclusionEdges) -> OcclusionEdges:
        """These and those of other pixels."""
        pairs = (
            (self.pixel, others.pixel),
            (self.beside, others.beside),
            (self.share, others.share),
        )
        return OcclusionEdges(*map(torch.cat, pairs))

    def blended(self, image: Float[Tensor, "h w 4"]) -> Float[Tensor, "h w 4"]:
        """A premultiplied image of what the centres show, with both sheets in these pixels; alpha stays. The same where there are none."""
        if not len(self.pixel):
            return image
        pixels = image.flatten(0, 1)
        own, other, share = pixels[self.pixel], pixels[self.beside], self.share[:, None]
        straight = other[:, :3] / other[:, 3:].clamp_min(1e-6)
        mixed = torch.cat([(1 - share) * own[:, :3] + share * own[:, 3:] * straight, own[:, 3:]], 1)
        return pixels.index_copy(0, self.pixel, mixed).view_as(image)
