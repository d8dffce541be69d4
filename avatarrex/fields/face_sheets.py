"""Which triangles of a face have static detail, and where that ends.

The learnt surface closes an open mouth before its teeth. So texels are in two sheets: those that show while the mouth is closed, met
along the surface's normal, fade out beside their triangles; where they do, a point has what the mesh shows further along the gaze:
teeth, tongue, the cavity around them, the other lip.

Letters: f triangles, p points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from avatarrex.fields.detail_texture import texel_count

BESIDE = (0.001, 0.004)
"""Metres beside a place, at right angles to the direction along which it was looked for, where its texels begin to fade, and are gone."""


@dataclass(frozen=True)
class FaceSheets:
    """The triangles of a face that have texels."""

    laid: Bool[np.ndarray, " f"]
    """Whether a triangle has texels."""
    behind: Bool[np.ndarray, " f"]
    """Whether it is hidden while the mouth is closed."""
    outer: Int[np.ndarray, " s"]
    """Those that have texels and show then."""
    end: bool
    """Whether texels fade out beside them; not in avatars of before, none of whose triangles is `behind`."""

    @classmethod
    def of(cls, edge: UInt8[Tensor, " f"], behind: UInt8[Tensor, " f"] | None) -> FaceSheets:
        """Of the texel intervals along edges, and 1 where a triangle is hidden; None in avatars of before."""
        laid = edge.cpu().numpy() > 0
        hidden = np.zeros_like(laid) if behind is None else behind.cpu().numpy() > 0
        return cls(laid, hidden, np.flatnonzero(laid & ~hidden), behind is not None)

    def of_texels(self, edge: UInt8[Tensor, " f"]) -> Int[Tensor, " t"]:
        """1 for the texels of hidden triangles."""
        return torch.from_numpy(np.repeat(self.behind, texel_count(edge.long().cpu().numpy())).astype(np.int64))


def share_beside(off: Float[np.ndarray, "p 3"], along: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
    """What is left of the texels of points `off` their places, metres, which were looked for `along` unit directions: 1 where one was met."""
    beside = np.linalg.norm(off - (off * along).sum(1, keepdims=True) * along, axis=1)
    share: np.ndarray = np.clip((BESIDE[1] - beside) / (BESIDE[1] - BESIDE[0]), 0, 1)
    return share
