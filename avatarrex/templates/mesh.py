"""Triangle meshes: normals, connected pieces. Letters: v vertices, f faces."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor


def vertex_normals(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Float[Tensor, "v 3"]:
    """Unit area-weighted vertex normals; zero where a vertex has no area."""
    a, b, c = vertices[faces].unbind(1)
    face_normals = torch.linalg.cross(b - a, c - a)  # as long as twice the area
    normals = torch.zeros_like(vertices)
    normals.index_add_(0, faces.reshape(-1), face_normals.repeat_interleave(3, 0))
    return torch.nn.functional.normalize(normals, dim=-1, eps=1e-20)


def pieces(faces: Int[Tensor, "f 3"], vertices: int) -> Int[Tensor, " f"]:
    """Which connected piece of a mesh of so many vertices each triangle is of."""
    rows = faces.numpy()
    edges = np.concatenate([rows[:, :2], rows[:, 1:]])
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(vertices, vertices))
    return torch.from_numpy(connected_components(graph, directed=False)[1])[faces[:, 0]]


def within_reach(rest: Float[Tensor, "v 3"], chosen: Bool[Tensor, " v"], reach: float) -> Bool[Tensor, " v"]:
    """Vertices nearer than `reach` metres to one of the chosen, those with them; none where none is chosen."""
    if not chosen.any():
        return chosen
    near: Tensor = torch.cdist(rest, rest[chosen]).amin(1) < reach
    return near
