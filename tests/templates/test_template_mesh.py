"""Meshes of templates."""

from __future__ import annotations

import torch

from avatarrex.templates.mesh import within_reach


def test_what_lies_within_reach() -> None:
    """Along a line, a centimetre apart; of no vertex nothing."""
    rest = torch.arange(5.0)[:, None] * torch.tensor([0.01, 0.0, 0.0])
    chosen = torch.tensor([True, False, False, False, False])
    assert within_reach(rest, chosen, 0.015).tolist() == [True, True, False, False, False]
    assert not within_reach(rest, torch.zeros(5, dtype=torch.bool), 1.0).any()
