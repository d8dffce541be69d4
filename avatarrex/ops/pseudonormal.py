"""Angle-weighted pseudonormals of a mesh's faces, edges and vertices: the exact inside test (Bærentzen & Aanæs 2005).

Vertices at one place are one vertex, repeated triangles count once. Triangles without a normal (zero area) leave the
pseudonormals of the features that they touch undefined: `unsure` names those, and their sign comes from the winding
number. Letters: p points, v vertices, f faces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.ops.pseudonormal_loops import gathered
from avatarrex.ops.triangle import THIN


@dataclass(frozen=True)
class Pseudonormals:
    """Outward directions, not normalised except the faces'."""

    face: Float[Tensor, "f 3"]
    edge: Float[Tensor, "f 3 3"]
    """Of the edge opposite corner i of each face."""
    vertex: Float[Tensor, "v 3"]
    flat_face: Bool[Tensor, " f"]
    """Faces without a normal."""
    flat_edge: Bool[Tensor, "f 3"]
    flat_vertex: Bool[Tensor, " v"]
    kept: Bool[Tensor, " f"]
    """False for the repeats of a triangle."""

    def of(self, chosen: Bool[Tensor, " f"]) -> Pseudonormals:
        """Of those faces alone, as they are in the whole mesh."""
        return replace(
            self,
            face=self.face[chosen],
            edge=self.edge[chosen],
            flat_face=self.flat_face[chosen],
            flat_edge=self.flat_edge[chosen],
            kept=self.kept[chosen],
        )

    def at(
        self, faces: Int[Tensor, "f 3"], face: Int[Tensor, " p"], barycentric: Float[Tensor, "p 3"]
    ) -> Float[Tensor, "p 3"]:
        """Unit pseudonormal of the feature that holds each surface point."""
        on_edge, edge, on_vertex, vertex = _feature(faces, face, barycentric)
        normal = torch.where(on_edge[:, None], self.edge[face, edge], self.face[face])
        return normalize(torch.where(on_vertex[:, None], self.vertex[vertex], normal), dim=-1)

    def unsure(
        self, faces: Int[Tensor, "f 3"], face: Int[Tensor, " p"], barycentric: Float[Tensor, "p 3"]
    ) -> Bool[Tensor, " p"]:
        """Points whose feature touches a triangle without a normal."""
        on_edge, edge, on_vertex, vertex = _feature(faces, face, barycentric)
        flat = torch.where(on_edge, self.flat_edge[face, edge], self.flat_face[face])
        return torch.where(on_vertex, self.flat_vertex[vertex], flat)


def _feature(faces: Tensor, face: Tensor, barycentric: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Exact zeros of the barycentrics say which feature: the search clamps, it does not round."""
    zero = barycentric <= 0
    count = zero.sum(-1)
    edge = zero.float().argmax(-1)
    vertex = faces[face, barycentric.argmax(-1)]
    return count == 1, edge, count == 2, vertex


def pseudonormals(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Pseudonormals:
    """Pseudonormals of a mesh, in the dtype of `vertices` (float64 where the sign must be exact)."""
    wanted = torch.is_grad_enabled() and vertices.requires_grad
    if vertices.device.type == "cpu" and vertices.dtype == torch.float64 and len(faces) and not wanted:
        if not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
            raise IndexError(f"faces name vertices {int(faces.min())} to {int(faces.max())} of {len(vertices)}")
        found = gathered(vertices.detach().contiguous().numpy(), faces.long().contiguous().numpy())
        return Pseudonormals(*map(torch.from_numpy, found))
    return pseudonormals_reference(vertices, faces)


def pseudonormals_reference(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Pseudonormals:
    """The same in torch operations: of any dtype, differentiable."""
    place, welded = torch.unique(vertices, dim=0, return_inverse=True)
    joined = welded[faces]
    kept = _first_of_repeats(joined, len(place))
    a, b, c = vertices[faces].unbind(1)
    sides = torch.stack([c - b, a - c, b - a], 1)
    length = sides.norm(dim=-1)
    cross = torch.linalg.cross(b - a, c - a)
    area = cross.norm(dim=-1)
    flat = area <= THIN * length.amax(1) ** 2
    face = torch.where(flat[:, None], 0.0, cross / torch.where(flat, 1.0, area)[:, None])
    counted = face * kept[:, None]
    edge_id = _edge_ids(joined, len(place))
    edge = torch.zeros(int(edge_id.max()) + 1, 3, dtype=vertices.dtype, device=vertices.device)
    edge.index_add_(0, edge_id.reshape(-1), counted.repeat_interleave(3, 0))
    flat_edge = torch.zeros(len(edge), dtype=torch.bool, device=vertices.device)
    flat_edge[edge_id[flat].reshape(-1)] = True
    # The angle at corner i lies between side (i+1) reversed and side (i+2); atan2 keeps digits for slivers.
    incoming, outgoing = -sides.roll(-1, 1), sides.roll(-2, 1)
    angle = torch.atan2(area[:, None].expand(-1, 3), (incoming * outgoing).sum(-1))
    vertex = torch.zeros_like(place)
    vertex.index_add_(0, joined.reshape(-1), (counted[:, None] * angle[..., None]).reshape(-1, 3))
    flat_vertex = torch.zeros(len(place), dtype=torch.bool, device=vertices.device)
    flat_vertex[joined[flat].reshape(-1)] = True
    return Pseudonormals(face, edge[edge_id], vertex[welded], flat, flat_edge[edge_id], flat_vertex[welded], kept)


def winding_number(
    vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], points: Float[Tensor, "p 3"]
) -> Float[Tensor, " p"]:
    """Sum of signed solid angles over 4π (van Oosterom & Strackee): 1 inside a closed mesh, 0 outside. Brute force."""
    total = []
    for chunk in points.split(max(1, 500_000 // max(1, len(faces)))):
        a, b, c = (vertices[faces][None] - chunk[:, None, None]).unbind(2)
        la, lb, lc = a.norm(dim=-1), b.norm(dim=-1), c.norm(dim=-1)
        volume = (a * torch.linalg.cross(b, c)).sum(-1)
        spread = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        total.append(2 * torch.atan2(volume, spread).sum(-1))
    return torch.cat(total) / (4 * math.pi)


def _edge_ids(faces: Tensor, count: int) -> Tensor:
    """(f, 3) number of the undirected edge opposite each corner."""
    start, end = faces[:, [1, 2, 0]].long(), faces[:, [2, 0, 1]].long()
    key = torch.minimum(start, end) * count + torch.maximum(start, end)
    return torch.unique(key, return_inverse=True)[1]


def _first_of_repeats(faces: Tensor, count: int) -> Tensor:
    """(f,) true for the first of triangles with the same corners in the same cyclic order."""
    faces = faces.long()
    first = faces.argmin(1, keepdim=True)
    turned = faces.gather(1, (first + torch.arange(3, device=faces.device)) % 3)
    pair = torch.unique(turned[:, 0] * count + turned[:, 1], return_inverse=True)[1]
    number = torch.unique(pair * count + turned[:, 2], return_inverse=True)[1]
    order = torch.arange(len(faces), device=faces.device)
    earliest = torch.full((len(faces),), len(faces), device=faces.device).scatter_reduce(0, number, order, "amin")
    kept: Tensor = earliest[number] == order
    return kept
