"""What was not found in a pose, taken from what was found around it on the skin.

    min Σ_{edges ab} ‖x_a − x_b‖² + ε Σ_a ‖x_a‖²,   x_a as it was observed where it was found

In crotch and armpit a vertex is found in few poses. A fit to these few alone says anything in the others, and of each vertex something
else: cloth tears. Between neighbours that were found it stays whole.

Letters: v vertices, f faces, c values of a vertex.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import splu

TOWARDS_ZERO = 1e-3
"""ε: what no edge joins to anything that was found has 0."""


def tension(faces: Int[np.ndarray, "f 3"], vertices: int) -> csr_array:
    """(v, v): half the slope of the sum."""
    start, end = faces.ravel(), np.roll(faces, -1, 1).ravel()
    link = coo_array((np.ones(2 * len(start)), (np.r_[start, end], np.r_[end, start])), (vertices,) * 2).tocsr()
    link.data[:] = 1
    return csr_array(diags_array(np.asarray(link.sum(1)).ravel() + TOWARDS_ZERO) - link)


def filled(
    value: Float[np.ndarray, "v c"], found: Bool[np.ndarray, " v"], tension: csr_array
) -> Float[np.ndarray, "v c"]:
    """`value` where it was `found`, the smoothest continuation of it elsewhere."""
    out, gap = value.copy(), np.flatnonzero(~found)
    if len(gap):
        own = tension[gap]
        out[gap] = splu(own[:, gap].tocsc()).solve(-(own[:, found] @ value[found]))
    return out
