"""Texels move as far as their slopes say, however rarely they are seen."""

import pytest
import torch

from avatarrex.training.core.texel_descent import TexelDescent


def moved(slopes: list[list[float]], rate: float = 0.01) -> list[float]:
    """How far texels have moved, of which each step has the slopes."""
    texel = torch.nn.Parameter(torch.zeros(len(slopes[0]), 3))
    descent = TexelDescent([texel], rate)
    for slope in slopes:
        texel.grad = torch.tensor(slope)[:, None].expand(-1, 3).contiguous()
        descent.step()
    return texel[:, 0].tolist()


def test_a_weak_slope_moves_little() -> None:
    """By the ratio of the slopes; Adam moves both by the rate."""
    strong, weak = moved([[-1.0, -0.01]] * 5)
    assert strong > 0
    assert weak == pytest.approx(strong / 100)


def test_a_single_look_moves_a_texel_once() -> None:
    """By the rate in all, beside one that is seen at each step: Adam goes on for 30."""
    often, once = moved([[-1.0, 0.0]] * 50 + [[-1.0, -1.0]] + [[-1.0, 0.0]] * 49)
    assert often == pytest.approx(1.0, rel=0.01)
    assert once == pytest.approx(0.01, rel=0.05)


def test_the_size_of_the_loss_does_not_count() -> None:
    assert moved([[1.0, 0.5]] * 3) == pytest.approx(moved([[100.0, 50.0]] * 3))


def test_steps_without_a_look_change_nothing() -> None:
    assert moved([[0.0, 0.0]] * 3) == [0.0, 0.0]
