"""Solids of the clothed subject, made from the default person's own surface (T-pose, metres).

A garment is a *filled* solid: an outer surface that stands off the skin and an inner one below it, stitched along the hem.
The union with the body is then solid throughout, with no thin air gaps, and the hem is a real step.

Letters: v vertices, f faces. NumPy float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import trimesh
from scipy.spatial import ConvexHull, cKDTree

INNER = 0.012
"""Metres below the skin of a garment's inner surface."""
TUCK = 0.006
"""Metres that covered skin is pushed in, so that it never shows through."""


@dataclass(frozen=True)
class Solid:
    """A closed surface with its own skinning and expression offsets."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    """(v, 55)."""
    expression_dirs: np.ndarray
    """(v, 3, 52)."""
    wrinkle: np.ndarray
    """(v,) metres: largest pose-dependent displacement."""


def normals_of(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit area-weighted vertex normals (v, 3)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def averaging(faces: np.ndarray, count: int) -> sp.csr_matrix:
    """Row-stochastic neighbour average (v, v)."""
    i = faces[:, [0, 1, 2]].ravel()
    j = faces[:, [1, 2, 0]].ravel()
    edges = sp.coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    edges.data[:] = 1
    degree = np.maximum(np.asarray(edges.sum(1)).ravel(), 1)
    return sp.diags(1 / degree) @ edges


def boundary_edges(faces: np.ndarray) -> np.ndarray:
    """(e, 2) half-edges without a partner."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    have = set(map(tuple, edges.tolist()))
    return np.array([edge for edge in have if edge[::-1] not in have], dtype=np.int64).reshape(-1, 2)


def smooth_boundary(vertices: np.ndarray, edges: np.ndarray, rounds: int = 12) -> np.ndarray:
    """Hems follow mesh edges in steps: average each boundary vertex with its two neighbours on the hem."""
    vertices = vertices.copy()
    ids = np.unique(edges)
    for _ in range(rounds):
        total, count = np.zeros_like(vertices), np.zeros(len(vertices))
        for a, b in ((0, 1), (1, 0)):
            np.add.at(total, edges[:, a], vertices[edges[:, b]])
            np.add.at(count, edges[:, a], 1)
        vertices[ids] = 0.5 * vertices[ids] + 0.5 * total[ids] / count[ids, None]
    return vertices


def garment(
    name: str,
    body: Solid,
    region: np.ndarray,
    offset: np.ndarray,
    smoothing: int,
    wrinkle: np.ndarray,
) -> Solid:
    """A filled solid over the body vertices in `region` (v,) bool, standing `offset` (v,) metres off the skin."""
    faces = body.faces[region[body.faces].all(1)]
    ids = np.unique(faces)
    index = np.full(len(region), -1)
    index[ids] = np.arange(len(ids))
    faces = index[faces]
    skin = body.vertices[ids]
    normal = normals_of(body.vertices, body.faces)[ids]
    mean = averaging(faces, len(ids))
    soft = normal.copy()
    for _ in range(10):
        soft = 0.5 * soft + 0.5 * (mean @ soft)
    soft /= np.linalg.norm(soft, axis=1, keepdims=True)
    edges = boundary_edges(faces)
    interior = np.ones(len(ids), dtype=bool)
    interior[np.unique(edges)] = False
    outer = skin + soft * offset[ids, None]
    for _ in range(smoothing):
        outer[interior] = 0.5 * outer[interior] + 0.5 * (mean @ outer)[interior]
        lift = np.einsum("vc,vc->v", outer - skin, normal)
        outer += normal * np.maximum(0.5 * offset[ids] - lift, 0)[:, None]
    outer = smooth_boundary(outer, edges)
    inner = smooth_boundary(skin - soft * INNER, edges)
    weights = body.weights[ids].copy()
    for _ in range(6):
        weights = 0.5 * weights + 0.5 * (mean @ weights)
    count = len(ids)
    a, b = edges[:, 0], edges[:, 1]
    rim = np.concatenate([np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)])
    return Solid(
        name,
        np.concatenate([outer, inner]),
        np.concatenate([faces, faces[:, ::-1] + count, rim]),
        np.concatenate([weights, weights]),
        np.concatenate([body.expression_dirs[ids]] * 2),
        np.concatenate([wrinkle[ids] * interior, np.zeros(count)]),
    )


def shoe(name: str, body: Solid, region: np.ndarray, grow: float = 0.007) -> Solid:
    """A closed shoe: the hull of the foot in `region`, grown by `grow` metres, with a flat sole."""
    points = body.vertices[region] + grow * normals_of(body.vertices, body.faces)[region]
    sole = points[:, 1].min() - 0.012
    points = np.concatenate([points, np.column_stack([points[:, 0], np.full(len(points), sole), points[:, 2]])])
    heel_free = points[:, 1] < np.quantile(points[:, 1], 0.9)
    hulls = [points[heel_free & (points[:, 2] > -0.02)], points[points[:, 2] < 0.05]]
    union = trimesh.util.concatenate([_hull(part) for part in hulls])
    tree = cKDTree(body.vertices[region])
    _, nearest = tree.query(union.vertices, k=8)
    weights = body.weights[region][nearest].mean(1)
    zeros = np.zeros((len(union.vertices), 3, body.expression_dirs.shape[2]))
    return Solid(name, union.vertices, union.faces, weights, zeros, np.zeros(len(union.vertices)))


def _hull(points: np.ndarray) -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(points, ConvexHull(points).simplices).convex_hull
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.015)
    mesh = trimesh.Trimesh(vertices, faces, process=True, merge_norm=True, merge_tex=True)
    mesh.merge_vertices()
    return mesh
