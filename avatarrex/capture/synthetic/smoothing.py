"""The neighbour average of a mesh's vertices. Letters: v vertices, f faces."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def averaging(faces: np.ndarray, count: int) -> sp.csr_matrix:
    """Row-stochastic average (v, v) over the vertices that share an edge; `faces` (f, 3) of `count` vertices."""
    i, j = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edges = sp.coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    edges.data[:] = 1
    return sp.diags(1 / np.maximum(np.asarray(edges.sum(1)).ravel(), 1)) @ edges
