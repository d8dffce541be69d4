"""Searching kd-trees: how many threads."""

from __future__ import annotations

import torch

FEW = 500
"""Points up to which one thread is done before others have started."""


def workers(points: int) -> int:
    """Threads that look up so many points."""
    return torch.get_num_threads() if points > FEW else 1
