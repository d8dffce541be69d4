"""Triangle meshes in NumPy: normals, points on triangles, neighbour averages. Letters: v vertices, f faces, p points."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals (f, 3) as long as twice the triangle's area, m²."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def interpolated(bary: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(p, …) of the triangles' corners (p, 3, …) by barycentrics (p, 3)."""
    return np.asarray(np.einsum("pk,pk...->p...", bary, corners))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit area-weighted vertex normals (v, 3)."""
    face = face_normals(vertices, faces)
    normal = np.stack([np.bincount(faces.ravel(), np.repeat(face[:, k], 3), len(vertices)) for k in range(3)], 1)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20))


def averaging(faces: np.ndarray, count: int) -> sp.csr_matrix:
    """Row-stochastic average (v, v) over the vertices that share an edge; `faces` (f, 3) of `count` vertices."""
    i, j = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edges = sp.coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    edges.data[:] = 1
    return sp.diags(1 / np.maximum(np.asarray(edges.sum(1)).ravel(), 1)) @ edges


def smoothed(mean: sp.csr_matrix, values: np.ndarray, rounds: int, own: float = 0.5) -> np.ndarray:
    """`values` (v, …) after some rounds of mixing their `own` share with the neighbours' average `mean` (v, v)."""
    for _ in range(rounds):
        values = own * values + (1 - own) * (mean @ values)
    return values
