"""The closest point of one triangle, where its normal is worth nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from avatarrex.ops.triangle import closest_on_triangle


@pytest.mark.parametrize("aspect", [0.0, 1e-16, 1e-14, 1e-12])
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_a_needle_is_its_longest_side(aspect: float, turn: int) -> None:
    """A triangle of that aspect departs from its longest side by `aspect`; what its normal says is rounding."""
    rng = np.random.default_rng(turn)
    start, end = rng.normal(size=(2, 500, 3))
    middle = start + rng.random((500, 1)) * (end - start)
    length = np.linalg.norm(end - start, axis=1, keepdims=True)
    corners = [start, end, middle + aspect * length * rng.normal(size=(500, 3)) / 2]
    point = middle + length * rng.normal(size=(500, 3)) * rng.choice([1e-6, 1e-2, 1], (500, 1))
    along = np.clip(((point - start) * (end - start)).sum(1, keepdims=True) / length**2, 0, 1)
    want = np.linalg.norm(point - start - along * (end - start), axis=1)
    a, b, c = (torch.as_tensor(corners[(k + turn) % 3]) for k in range(3))
    square, weight = closest_on_triangle(torch.as_tensor(point), a, b, c)
    assert np.abs(square.sqrt().numpy() - want).max() < 1e-11
    surface = (torch.stack([a, b, c], 1) * weight[..., None]).sum(1)
    assert ((torch.as_tensor(point) - surface).norm(dim=-1) - square.sqrt()).abs().max() < 1e-11
