"""Texels that few pictures show follow their neighbours; those that many show hardly do."""

import numpy as np
import torch

from avatarrex.training.core.agreement import agreed

CHAIN = np.stack([np.arange(4), np.arange(1, 5)], 1)


def test_the_system_is_the_stated_one() -> None:
    """Of the sum of squares that the module states, by its slope."""
    weight, mean = torch.tensor([2.0, 0.5, 0.1, 1.0, 3.0]), torch.rand(5, 3, dtype=torch.double)
    found = agreed(mean, weight, CHAIN, 0.7).requires_grad_(True)
    loss = (weight[:, None] * (found - mean).square()).sum()
    loss = loss + 0.7 * (found[CHAIN[:, 0]] - found[CHAIN[:, 1]]).square().sum()
    (slope,) = torch.autograd.grad(loss, found)
    assert slope.abs().max() < 1e-3


def test_what_no_picture_shows_is_continued() -> None:
    grey = agreed(torch.tensor([[0.2], [0.9], [0.9], [0.9], [0.6]]), torch.tensor([100.0, 0, 0, 0, 100]), CHAIN)[:, 0]
    torch.testing.assert_close(grey, torch.tensor([0.2, 0.3, 0.4, 0.5, 0.6]), atol=0.01, rtol=0)


def test_what_many_show_stays() -> None:
    mean = torch.tensor([[0.0], [1.0], [0.0], [1.0], [0.0]])
    torch.testing.assert_close(agreed(mean, torch.full((5,), 1e3), CHAIN), mean, atol=1e-3, rtol=0)
