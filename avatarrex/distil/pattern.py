"""Where a printed pattern has gone: the exact colours slide over the rest position as the pose changes, by up to a centimetre.

The networks see millimetres of a moving cloth as changed colours, not as a moved place. A texture cannot follow that, a vertex can:
Lucas and Kanade (1981) on the surface. At samples inside the triangles, with J the slope of the albedo along the surface in the
reference pose and d the reference albedo less that of the pose, each vertex moves by

    u = (Σ Jᵀ J + λ I)⁻¹ Σ Jᵀ d,     sums over its own triangles and, smoothed, its neighbours'

Letters: s samples, v vertices, f faces. Metres at rest; colours sRGB-encoded with the light divided out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from torch import Tensor
from torch.nn.functional import normalize

CORNERS = ((2 / 3, 1 / 6, 1 / 6), (1 / 6, 2 / 3, 1 / 6), (1 / 6, 1 / 6, 2 / 3), (1 / 3, 1 / 3, 1 / 3))
"""Barycentric coordinates of a triangle's samples, some 4 mm apart."""
SLOPE = 0.002
"""Metres over which a colour's slope is taken."""
SMOOTHINGS = 4
"""Averages over the neighbours: a window of some 4 cm, which holds more than one stripe."""
PENALTY = 40.0
"""λ per sample, (sRGB / m)²: a step of 0.02 over 3 mm decides; what is flatter stays."""
MOST = 0.006
"""Metres of one step."""


@dataclass(frozen=True)
class Pattern:
    """Samples on the triangles that may slide, with their albedo in the reference pose."""

    corner: Int[Tensor, "s 3"]
    barycentric: Float[Tensor, "s 3"]
    albedo: Float[Tensor, "s 3"]
    slope: Float[Tensor, "s 3 3"]
    """Change of each colour channel by a metre along each axis of rest."""
    gather: csr_array
    """(v, s): which samples count for a vertex."""
    smooth: csr_array
    """(v, v): mean of a vertex and its neighbours."""

    def at(self, values: Float[Tensor, "v c"]) -> Float[Tensor, "s c"]:
        """Vertex values at the samples."""
        return (values[self.corner] * self.barycentric[:, :, None]).sum(1)

    def slide(self, albedo: Float[Tensor, "s 3"], trusted: Float[Tensor, " s"]) -> Float[Tensor, "v 3"]:
        """How far each vertex has to move along the surface, metres at rest, to see the reference albedo; `trusted` in [0, 1]."""
        weight = trusted.double().numpy()[:, None]
        slope = self.slope.double().numpy()
        miss = (self.albedo - albedo).double().numpy()
        normal = np.einsum("sca,scb->sab", slope, slope).reshape(-1, 9) + PENALTY * np.eye(3).ravel()
        sums = self.gather @ np.concatenate([weight * normal, weight * np.einsum("sca,sc->sa", slope, miss)], 1)
        sums[:, :9] += 1e-3 * np.eye(3).ravel()
        for _ in range(SMOOTHINGS):
            sums = self.smooth @ sums
        move = np.linalg.solve(sums[:, :9].reshape(-1, 3, 3), sums[:, 9:, None])[:, :, 0]
        length = np.linalg.norm(move, axis=1, keepdims=True)
        return torch.as_tensor(move * np.minimum(1, MOST / np.maximum(length, 1e-9)), dtype=torch.float32)


def sample_places(faces: np.ndarray) -> tuple[Tensor, Tensor]:
    """Corners (s, 3) and barycentric coordinates (s, 3) of the samples of `faces` (f, 3)."""
    corner = torch.as_tensor(np.repeat(faces.astype(np.int64), len(CORNERS), 0))
    return corner, torch.tensor(CORNERS).repeat(len(faces), 1)


def tangents(position: Float[Tensor, "v 3"], corner: Int[Tensor, "s 3"]) -> Float[Tensor, "s 2 3"]:
    """Two unit directions along each sample's triangle."""
    a, b, c = (position[corner[:, k]] for k in range(3))
    first = normalize(b - a, dim=-1)
    normal = normalize(torch.linalg.cross(b - a, c - a), dim=-1)
    return torch.stack([first, torch.linalg.cross(normal, first)], 1)


def neighbourhoods(corner: np.ndarray, faces: np.ndarray, vertices: int) -> tuple[csr_array, csr_array]:
    """`gather` and `smooth` of a `Pattern`."""
    s = len(corner)
    gather = coo_array((np.ones(3 * s), (corner.ravel(), np.repeat(np.arange(s), 3))), (vertices, s)).tocsr()
    start, end = faces.ravel(), np.roll(faces, -1, 1).ravel()
    ones = np.ones(2 * len(start))
    link = coo_array((ones, (np.r_[start, end], np.r_[end, start])), (vertices, vertices)).tocsr()
    link.data[:] = 1
    link = link + coo_array((np.ones(vertices), (np.arange(vertices),) * 2), (vertices, vertices)).tocsr()
    degree = np.asarray(link.sum(1)).ravel()
    return gather, (coo_array((1 / degree, (np.arange(vertices),) * 2)).tocsr() @ link).tocsr()
