"""What floats beside a body, a few voxels large, is taken out of the grid, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar_file import load_avatar
from avatarrex.counters import Counters
from avatarrex.reference.solids import Solid, body_grid, capsule, sphere, union
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import pose_person
from avatarrex.volume import build
from avatarrex.volume.body_grid import build_body_grid
from avatarrex.volume.sdf_volume import BodyGrid
from avatarrex.volume.small_components import without_small_components

BODY = capsule((0.2, 0.1, 0.2), (0.2, 0.5, 0.2), 0.06)


def grid_of(*solids: Solid) -> BodyGrid:
    """Their union, every voxel known."""
    grid = body_grid(union(*solids), (0, 0, 0), 0.02, (31, 31, 31))
    return replace(grid, known=np.ones(tuple(grid.sdf.shape), dtype=bool))


@pytest.mark.parametrize("place", [(0.4, 0.3, 0.2), (0.41, 0.31, 0.21), (0.31, 0.3, 0.2)])
def test_a_small_component_is_emptied_and_nothing_else(place: tuple[float, float, float]) -> None:
    alone, both = grid_of(BODY), grid_of(BODY, sphere(place, 0.018))
    assert (both.sdf < 0).sum() > (alone.sdf < 0).sum(), "there is a component"
    cleared = without_small_components(both)
    component = (both.sdf < 0) & (alone.sdf >= 0)
    assert torch.equal(cleared.sdf < 0, alone.sdf < 0)
    assert torch.equal(cleared.sdf[~component], both.sdf[~component])
    assert (cleared.sdf[component] > 0).all()
    assert (cleared.sdf[component] <= alone.sdf[component]).all(), "rays step no farther than to the body"
    assert cleared.known is not None
    assert np.array_equal(~cleared.known, component.numpy())


def test_what_is_larger_stays() -> None:
    grid = grid_of(BODY, sphere((0.45, 0.3, 0.2), 0.05))
    assert without_small_components(grid) is grid


def test_what_interpolation_joins_to_the_body_stays() -> None:
    """A voxel that touches the body at a corner: the values between are inside, or are not."""
    sdf = grid_of(BODY).sdf.clone()
    z, y, x = (int(i) for i in torch.nonzero(sdf < 0)[0])
    sdf[z - 1, y, x - 1] = -0.01  # a diagonal neighbour
    sdf[z - 1, y, x] = sdf[z, y, x - 1] = 0.001
    sdf[z, y, x] = -0.01
    joined = BodyGrid(np.zeros(3), 0.02, sdf)
    assert without_small_components(joined) is joined
    sdf = sdf.clone()
    sdf[z - 1, y, x] = sdf[z, y, x - 1] = 0.02
    assert float(without_small_components(BodyGrid(np.zeros(3), 0.02, sdf)).sdf[z - 1, y, x - 1]) > 0


@pytest.mark.parametrize("everywhere", [False, True])
def test_levels_have_none_but_the_papers(everywhere: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def crumbling(*arguments, **named) -> BodyGrid:
        grid = build_body_grid(*arguments, **named)
        grid.sdf[1, 1, 1] = -0.005
        return grid

    monkeypatch.setattr(build, "build_body_grid", crumbling)
    avatar = load_avatar()
    posed = pose_person(avatar.person, Signals.rest(), Counters(), None)
    settings = RenderSettings(voxel=0.04, part_voxel=0.02, everywhere=everywhere)
    volume = build.build_volume(avatar, posed, settings, Counters(), None)
    assert (float(volume.grid.sdf[1, 1, 1]) < 0) == everywhere
