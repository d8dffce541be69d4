"""A gaze onto a field, against closed forms."""

from __future__ import annotations

import torch
from torch import Tensor

from avatarrex.distil.onto_field import met_from


def test_a_gaze_meets_a_hollow_ball_from_within():
    """From inside a cavity of 2 cm every gaze ends on its wall, whether the vertex lies before or behind it."""

    def sdf(position: Tensor) -> Tensor:
        return 0.02 - position.norm(dim=-1)

    eye = torch.tensor([0.0, 0.0, 0.01])
    vertices = torch.tensor([[0.0, 0.005, 0.01], [0.05, 0.0, 0.01], [0.0, 0.0, -0.04]])
    met = met_from(sdf, eye, vertices)
    across = 0.0003**0.5
    wall = torch.tensor([[0.0, across, 0.01], [across, 0.0, 0.01], [0.0, 0.0, -0.02]])
    assert torch.allclose(met, wall, atol=2e-5)
