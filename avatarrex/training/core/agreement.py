"""Agreement of neighbouring texels: the less a texel was seen, the more it follows those beside it. Ours.

    min Σ_t w_t (c_t − m_t)² + λ Σ_(t,u) (c_t − c_u)²          over colours c, m_t the mean of what pictures show, w_t their weight

A sparse linear system, by conjugate gradients. A texel that no picture shows has, all but freely (`LEAST`), the colour of the
nearest seen one: c there is a smooth continuation of what lies around.

Letters: t texels, e pairs of neighbours.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import cg
from torch import Tensor

TIE = 0.3
"""λ: w of a texel is about 0.5 a picture that looks straight at it."""
LEAST = 1e-3
"""w of texels that no picture shows."""
NEAR, STEPS = 1e-4, 60
"""Relative residual at which the solution is good enough, and steps at most."""


def agreed(
    mean: Float[Tensor, "t c"], weight: Float[Tensor, " t"], pairs: Int[np.ndarray, "e 2"], tie: float = TIE
) -> Float[Tensor, "t c"]:
    """Colours c; `mean` m has a guess where `weight` is 0."""
    screen = weight.double().clamp_min(LEAST).numpy()
    system = (tie * laplacian(pairs, len(mean)) + diags(screen)).tocsr()
    unit = 1 / np.sqrt(
        system.diagonal()
    )  # of each unknown: residuals of texels that are hardly seen count as others do
    scaled = diags(unit) @ system @ diags(unit)
    columns = [
        unit * cg(scaled, unit * screen * column, x0=column / unit, rtol=NEAR, maxiter=STEPS)[0]
        for column in mean.double().T.numpy()
    ]
    return torch.from_numpy(np.stack(columns, 1)).to(mean)


def laplacian(pairs: Int[np.ndarray, "e 2"], count: int) -> csr_matrix:
    """(t, t): Σ over neighbours of the difference to them."""
    ones = np.ones(len(pairs))
    joined = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), (count, count))
    joined = (joined + joined.T).tocsr()
    return diags(np.asarray(joined.sum(1))[:, 0]) - joined
