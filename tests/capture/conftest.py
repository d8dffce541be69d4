"""Fixtures of the capture tests."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded, so that a failure comes back."""
    return np.random.default_rng(7)
