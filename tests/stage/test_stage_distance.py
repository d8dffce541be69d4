"""Distances far from a surface, of volumes that store lower bounds there."""

import numpy as np
import pytest
import torch
from stage.solid_volume import banded

from avatarrex.reference.solids import capsule, capsule_man, sphere, union
from avatarrex.stage.distance import FARTHEST, distance_grid
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume, distance

SOLIDS = {
    "ball": sphere((0.02, -0.01, 0.0), 0.13),
    "bar and ball": union(capsule((-0.2, -0.2, 0.0), (0.2, -0.1, 0.05), 0.05), sphere((0.1, 0.2, 0.0), 0.08)),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_bounds_become_distances(name):
    solid, volume = SOLIDS[name], banded(SOLIDS[name])
    points = torch.from_numpy(np.random.default_rng(0).uniform(-0.39, 0.39, (4000, 3)))
    truth = solid(points)
    assert (distance(volume, points) - truth).abs().max() > 0.05, "the stored ones are bounds"
    found = distance_grid(volume).sample(points)
    outside = truth > 0
    apart = (found - truth)[outside].abs()
    assert apart.max() < 0.012
    assert apart.mean() < 0.004
    assert ((found < 0) == (truth < 0))[truth.abs() > 0.006].all()


def test_beyond_the_grid_the_way_to_it_is_added():
    grid = distance_grid(banded(SOLIDS["ball"]))
    far = torch.tensor([[0.9, 0.0, 0.0]], dtype=torch.float64)
    assert grid.sample(far).item() == pytest.approx(0.9 - 0.02 - 0.13, abs=0.01)


def test_parts_belong_to_it():
    """A finger of 16 mm, which the body's grid does not have."""
    volume = capsule_man(shape=(40, 100, 96))
    tip = torch.tensor([[0.55 + 0.17 * np.cos(0.5), 0.35 - 0.17 * np.sin(0.5), 0.015 + 0.02]], dtype=torch.float64)
    assert distance_grid(volume).sample(tip).item() < 0.012
    assert distance(SdfVolume(volume.body), tip).item() > 0.015


def test_it_is_made_once_and_nothing_is_far_from_everything():
    volume = banded(SOLIDS["ball"])
    assert distance_grid(volume) is distance_grid(volume)
    empty = SdfVolume(BodyGrid(np.zeros(3), 0.02, torch.ones(5, 6, 7)))
    assert (distance_grid(empty).values == FARTHEST).all()
