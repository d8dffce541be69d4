"""The pattern that slid is followed back: a plane with stripes, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from avatarrex.distil.pattern import Pattern, neighbourhoods, sample_places

STRIPE = 0.03
"""Metres of a period."""


def stripes(x: torch.Tensor) -> torch.Tensor:
    return (0.5 + 0.4 * torch.sin(2 * np.pi * x / STRIPE))[:, None].repeat(1, 3)


def plane(side: int = 24, step: float = 0.006) -> tuple[torch.Tensor, np.ndarray]:
    row, column = np.divmod(np.arange(side * side), side)
    corner = (np.arange((side - 1) ** 2) // (side - 1)) * side + np.arange((side - 1) ** 2) % (side - 1)
    upper, lower = (
        np.stack([corner, corner + 1, corner + side], 1),
        np.stack([corner + 1, corner + side + 1, corner + side], 1),
    )
    place = np.stack([step * column, step * row, 0 * row], 1)
    return torch.tensor(place, dtype=torch.float32), np.concatenate([upper, lower])


@pytest.mark.parametrize("slid", [0.002, -0.003])
def test_vertices_move_to_where_the_pattern_has_gone(slid):
    vertices, faces = plane()
    corner, barycentric = sample_places(faces)
    x = (vertices[corner] * barycentric[:, :, None]).sum(1)[:, 0]
    slope = torch.zeros(len(x), 3, 3)
    slope[:, :, 0] = (0.4 * 2 * np.pi / STRIPE * torch.cos(2 * np.pi * x / STRIPE))[:, None]
    gather, smooth = neighbourhoods(corner.numpy(), faces, len(vertices))
    pattern = Pattern(corner, barycentric, stripes(x), slope, gather, smooth)
    move = pattern.slide(stripes(x - slid), torch.ones(len(x)))
    inner = ((vertices > 0.03) & (vertices < 0.11))[:, :2].all(1)
    assert move[inner, 0].mean() == pytest.approx(slid, rel=0.15)
    assert move[inner, 0].std() < 0.25 * abs(slid)
    assert move[:, 1:].abs().max() < 1e-6
    assert pattern.slide(stripes(x - slid), torch.zeros(len(x))).abs().max() == 0
    trusted = (torch.arange(len(x)) % 3 > 0).float()
    spoiled = torch.where(trusted[:, None] > 0, stripes(x - slid), torch.ones(1))
    assert pattern.slide(spoiled, trusted)[inner, 0].mean() == pytest.approx(slid, rel=0.15)


def test_nothing_moves_where_nothing_is_printed():
    vertices, faces = plane(6)
    corner, barycentric = sample_places(faces)
    grey, flat = torch.full((len(corner), 3), 0.5), torch.zeros(len(corner), 3, 3)
    pattern = Pattern(corner, barycentric, grey, flat, *neighbourhoods(corner.numpy(), faces, len(vertices)))
    assert pattern.slide(grey + 0.1, torch.ones(len(corner))).abs().max() == 0
