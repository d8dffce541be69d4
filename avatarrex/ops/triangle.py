"""The closest point of one triangle to one point, robust for slivers and degenerate triangles (paper eq. 8).

The minimum over three clamped segments; the interior counts only where the triangle has a well-conditioned normal
(docs/stress.md: a sliver of aspect 1e-4 otherwise gives errors of 17 mm and NaN).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

THIN = 1e-10
"""Height over longest edge below which a triangle is its three segments: the error is then below 1e-10 of its size.
Compiled into closest_triangle.py and pseudonormal_loops.py (ops/native.py)."""
Vector = tuple[Tensor, Tensor, Tensor]


def closest_on_triangle(
    point: Float[Tensor, "*q 3"], a: Float[Tensor, "*t 3"], b: Float[Tensor, "*t 3"], c: Float[Tensor, "*t 3"]
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b 3"]]:
    """Squared distance (m²) and barycentric coordinates of the closest point; shapes broadcast.

    A zero barycentric is exactly zero: it tells the feature (face, edge, vertex) that holds the point.
    """
    origin = _split(a)
    ab, ac, ap = (_minus(_split(x), origin) for x in (b, c, point))
    bc, bp = _minus(ac, ab), _minus(ap, ab)
    ab2, ac2, bc2 = _dot(ab, ab), _dot(ac, ac), _dot(bc, bc)
    normal = _cross(ab, ac)
    area2 = _dot(normal, normal)
    longest = torch.maximum(torch.maximum(ab2, ac2), bc2)
    thick = area2 > (THIN * longest) ** 2
    scale = torch.where(thick, area2, 1.0)
    v = _dot(_cross(ap, ac), normal) / scale
    w = _dot(_cross(ab, ap), normal) / scale
    u = 1 - v - w
    inside = thick & (torch.minimum(torch.minimum(v, w), u) >= 0)
    along_ab, along_ac, along_bc = _clamped(ap, ab, ab2), _clamped(ap, ac, ac2), _clamped(bp, bc, bc2)
    square_ab, square_ac, square_bc = _gap(ap, ab, along_ab), _gap(ap, ac, along_ac), _gap(bp, bc, along_bc)
    best = torch.minimum(torch.minimum(square_ab, square_ac), square_bc)
    on_ab, on_ac = square_ab <= best, square_ac <= best
    zero = torch.zeros_like(best)
    edge_v = torch.where(on_ab, along_ab, torch.where(on_ac, zero, 1 - along_bc))
    edge_w = torch.where(on_ab, zero, torch.where(on_ac, along_ac, along_bc))
    edge_u = torch.where(on_ab, 1 - along_ab, torch.where(on_ac, 1 - along_ac, zero))
    weight = [torch.where(inside, face, edge) for face, edge in ((u, edge_u), (v, edge_v), (w, edge_w))]
    height = _dot(ap, normal)
    return torch.where(inside, height * height / scale, best), torch.stack(weight, -1)


def _clamped(point: Vector, along: Vector, square: Tensor) -> Tensor:
    """Where on the segment, in [0, 1]; 0 on a segment of no length."""
    return (_dot(point, along) / square.clamp_min(torch.finfo(square.dtype).tiny)).clamp(0, 1)


def _gap(point: Vector, along: Vector, t: Tensor) -> Tensor:
    offset = _minus(point, (along[0] * t, along[1] * t, along[2] * t))
    return _dot(offset, offset)


def _split(x: Tensor) -> Vector:
    return x[..., 0], x[..., 1], x[..., 2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: Vector, b: Vector) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
