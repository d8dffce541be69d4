"""The closest point of a mesh for points that lie beside it: pixels on a hand, not voxels of a box.

Only the triangles with the nearest centres are compared: near a mesh of even triangles the closest is among them. On the
pixels of a posed hand none is missed; of points spread over all triangles, the long ones of the wrist's stub included,
one in a hundred is, by 1.2 mm at most (tests/ops/test_closest_near.py). Far from the mesh it need not be among them. What a mesh
needs is prepared once and kept while it stands still. Letters: p points, v vertices, f faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.ops.closest_point import ClosestPoint, signed
from avatarrex.ops.pseudonormal import Pseudonormals, pseudonormals
from avatarrex.ops.triangle import closest_on_triangle

NEIGHBOURS = 16
"""Triangles that are compared; 8 erred by 0.02 mm at the worst pixel of a hand, 12 by nothing."""


@dataclass(frozen=True)
class NearMesh:
    """A mesh, prepared."""

    vertices: Float[Tensor, "v 3"]
    faces: Int[Tensor, "f 3"]
    corner: Float[Tensor, "f 3 3"]
    """Float64."""
    normals: Pseudonormals
    centres: cKDTree

    @staticmethod
    def of(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> NearMesh:
        """Of posed vertices, metres; no gradient flows into them."""
        mesh = vertices.detach().double()
        corner = mesh[faces]
        return NearMesh(vertices.detach(), faces, corner, pseudonormals(mesh, faces), cKDTree(corner.mean(1).numpy()))

    @torch.no_grad()
    def closest(self, points: Float[Tensor, "p 3"]) -> ClosestPoint:
        """Signed distance, face and barycentrics of points (metres, finite) near the mesh."""
        query = points.detach().double()
        ranks = list(range(1, min(NEIGHBOURS, len(self.faces)) + 1))
        index = self.centres.query(query.numpy(), ranks, workers=torch.get_num_threads())[1]
        near = torch.from_numpy(index).reshape(len(query), len(ranks))
        square, weight = closest_on_triangle(query[:, None], *self.corner[near].unbind(2))
        row, best = torch.arange(len(query)), square.argmin(1)
        return signed(self.vertices, self.faces, points, near[row, best], weight[row, best], self.normals)
