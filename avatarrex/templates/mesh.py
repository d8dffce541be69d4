"""Triangle meshes: normals. Letters: v vertices, f faces."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor


def face_normals(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Float[Tensor, "f 3"]:
    """Unnormalised: length is twice the area, m²."""
    a, b, c = vertices[faces].unbind(1)
    normal: Tensor = torch.linalg.cross(b - a, c - a)
    return normal


def vertex_normals(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Float[Tensor, "v 3"]:
    """Unit area-weighted vertex normals; zero where a vertex has no area."""
    normals = torch.zeros_like(vertices)
    normals.index_add_(0, faces.reshape(-1), face_normals(vertices, faces).repeat_interleave(3, 0))
    return torch.nn.functional.normalize(normals, dim=-1, eps=1e-20)
