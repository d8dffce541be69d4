"""Fréchet inception distance between two sets of pictures (Heusel et al. 2017).

    FID = |μ₁ − μ₂|² + tr(Σ₁ + Σ₂ − 2 (Σ₁^½ Σ₂ Σ₁^½)^½)

over the features of `inception.py`, in float64. With Σ₁ = AᵀA and Σ₂ = BᵀB, the rows of A and B being the centred features
over √(n − 1), the last trace is the sum of the singular values of ABᵀ: small, and exact where Σ is singular.

With fewer pictures than features Σ is singular and the value is biased upwards: compare only values
over the same pictures. Letters: n pictures, d features.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from avatarrex.errors import check


def frechet_distance(a: Float[np.ndarray, "n d"], b: Float[np.ndarray, "m d"]) -> float:
    """Between the normal distributions with the means and (unbiased) covariances of two sets of features.

    Raises `InputError` for fewer than two in a set.
    """
    check(min(len(a), len(b)) >= 2, "fid", "pictures", "at least two in each set", min(len(a), len(b)))
    a, b = a.astype(np.float64), b.astype(np.float64)
    root_a, root_b = (_root(features) for features in (a, b))
    shared = np.linalg.svd(root_a @ root_b.T, compute_uv=False).sum()
    spread = (root_a**2).sum() + (root_b**2).sum() - 2 * shared
    return float(((a.mean(0) - b.mean(0)) ** 2).sum() + max(spread, 0.0))


def _root(features: np.ndarray) -> np.ndarray:
    """A with AᵀA the covariance, at most d rows."""
    centred = (features - features.mean(0)) / np.sqrt(len(features) - 1)
    return np.asarray(np.linalg.qr(centred, mode="r")) if len(centred) > centred.shape[1] else centred
