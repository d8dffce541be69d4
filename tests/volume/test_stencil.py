"""Voxel–node pairs: the stencil lists what all distances list."""

import numpy as np
import pytest
import torch

from avatarrex.volume.body_grid import MAX_SIDE, lattice_around
from avatarrex.volume.stencil import Lattice, stencil_pairs, stencil_pairs_reference


@pytest.mark.parametrize("seed", range(4))
def test_stencil_agrees_with_all_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lattice = Lattice(rng.normal(size=3), 0.02, (23, 31, 17))
    index = np.flatnonzero(rng.random(23 * 31 * 17) < 0.4)
    nodes = torch.as_tensor(lattice.origin + rng.uniform(-0.2, 0.8, (9, 3)))
    fast, slow = stencil_pairs(nodes, lattice, index), stencil_pairs_reference(nodes, lattice, index)
    assert len(fast.point) > 20
    assert torch.equal(fast.offsets, slow.offsets)
    assert torch.equal(fast.node, slow.node)
    for k in range(9):
        rows = slice(int(fast.offsets[k]), int(fast.offsets[k + 1]))
        assert torch.equal(fast.point[rows].sort().values, slow.point[rows].sort().values)


def test_nothing_listed_gives_no_pairs() -> None:
    pairs = stencil_pairs(torch.zeros(3, 3), Lattice(np.zeros(3), 0.02, (4, 4, 4)), np.zeros(0, dtype=np.int64))
    assert len(pairs.point) == 0


def test_the_voxel_grows_rather_than_cutting_off_a_giant() -> None:
    small = lattice_around(np.array([[0.0, 0, 0], [0.5, 1.9, 0.3]]), 0.02)
    assert small.voxel == 0.02
    tall = lattice_around(np.array([[0.0, 0, 0], [0.5, 3.4, 0.3]]), 0.02)
    assert tall.voxel > 0.02
    assert max(tall.shape) <= MAX_SIDE
    assert tall.position(np.array([np.prod(tall.shape) - 1]))[0, 1] >= 3.4
