"""The lattice of the body."""

import numpy as np

from avatarrex.volume.body_grid import MAX_SIDE, lattice_around


def test_the_voxel_grows_rather_than_cutting_off_a_giant() -> None:
    small = lattice_around(np.array([[0.0, 0, 0], [0.5, 1.9, 0.3]]), 0.02)
    assert small.voxel == 0.02
    tall = lattice_around(np.array([[0.0, 0, 0], [0.5, 3.4, 0.3]]), 0.02)
    assert tall.voxel > 0.02
    assert max(tall.shape) <= MAX_SIDE
    assert tall.position(np.array([np.prod(tall.shape) - 1]))[0, 1] >= 3.4
