"""A mesh whose folds, an ear or toes, are drawn flat like a skin of soap over the opening they stand on.

A learnt surface is smoother than an ear. Its closest places on one gather on rims and jump between front, back and the head
behind, so that what is looked up there are strokes. On the membrane they follow each other as on any smooth skin; it has the
same triangles.

Letters: v vertices, f triangles. Metres.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree
from torch import Tensor

NEAR, APART = 0.006, 0.3
"""Metres about a vertex; where the mean normal of the triangles in them is shorter than 1 by so much, there is a fold."""
BESIDE = 0.012
"""Metres that a fold is wider than that."""
FAR = 0.03
"""Metres from its membrane: what reaches so far is no fold but the end of a limb, or a cavity."""


def membrane(vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> Float[Tensor, "v 3"]:
    """Where the vertices are when each in a fold lies in the middle of those it has edges with."""
    place, mesh = vertices.double().numpy(), faces.numpy()
    pairs = mesh[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = csr_matrix((np.ones(len(pairs)), pairs.T), (len(place), len(place)))
    edges = ((edges + edges.T) > 0).astype(float)
    laplacian = (diags(np.asarray(edges.sum(1)).ravel()) - edges).tocsr()
    wide, found = np.flatnonzero(folded(place, mesh)), place.copy()
    pieces, piece = connected_components(edges[wide][:, wide], directed=False)
    for number in range(pieces):
        free = np.zeros(len(place), bool)
        free[wide[piece == number]] = True
        rim = -(laplacian[free][:, ~free] @ place[~free])
        if not rim.any():
            continue
        flat = np.atleast_2d(spsolve(laplacian[free][:, free].tocsc(), rim))
        if np.linalg.norm(flat - place[free], axis=1).max() < FAR:
            found[free] = flat
    return torch.from_numpy(found)


def folded(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " v"]:
    """Which vertices lie in a fold or beside one."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    near = cKDTree(vertices).sparse_distance_matrix(cKDTree(corner.mean(1)), NEAR, output_type="coo_matrix")
    around = csr_matrix((np.ones(near.nnz), (near.row, near.col)), near.shape)
    within = np.linalg.norm(around @ normal, axis=1) < (1 - APART) * (around @ np.linalg.norm(normal, axis=1))
    if not within.any():
        return np.zeros(len(vertices), bool)
    found: np.ndarray = cKDTree(vertices[within]).query(vertices)[0] < BESIDE
    return found
