"""Bricks: the finer grid's values around the surface, wherever it is seen, and nothing else."""

import numpy as np
import pytest
import torch

from avatarrex.reference.solids import body_grid, capsule, lattice_points, sphere, union
from avatarrex.volume.bricks import ROW, Bricks, grow_bricks
from avatarrex.volume.sdf_volume import BodyGrid

ORIGIN, VOXEL, SHAPE = (-0.3, -0.3, -0.3), 0.02, (31, 32, 33)
PIN = union(sphere((0.001, 0.002, 0.003), 0.1701), capsule((0, 0.1, 0), (0.02, 0.27, 0.01), 0.018))
"""A ball with a pin about as thick as the coarse voxels."""


class Field:
    """The exact distance, counting what it was queried for."""

    def __init__(self) -> None:
        self.queried = 0

    def __call__(self, place: np.ndarray) -> np.ndarray:
        self.queried += len(place)
        return PIN(torch.from_numpy(VOXEL * place) + torch.tensor(ORIGIN).double()).float().numpy()


def crossed_cells(grid: BodyGrid) -> np.ndarray:
    """Flat cells of a grid in which its sign changes."""
    inside = torch.nn.functional.avg_pool3d((grid.sdf < 0)[None, None].float(), 2, 1)[0, 0]
    return np.flatnonzero(((inside > 0) & (inside < 1)).numpy())


def grown(side: int, seen: np.ndarray, field: Field, kept: Bricks | None = None) -> Bricks:
    grid = body_grid(PIN, ORIGIN, VOXEL, SHAPE)
    sdf = grid.sdf.numpy()
    return grow_bricks(sdf, VOXEL, kept or Bricks.none(side, sdf), seen, field)


@pytest.mark.parametrize("side", [2, 4])
def test_corners_of_crossed_cells_are_the_finer_grid(side: int) -> None:
    field = Field()
    bricks = grown(side, crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE)), field)
    fine = body_grid(PIN, ORIGIN, VOXEL / side, tuple((n - 1) * side + 1 for n in SHAPE)).sdf.numpy()
    corner = np.stack(np.unravel_index(bricks.cell, tuple(n - 1 for n in SHAPE)), -1) * side
    places = corner[:, None, None, None] + np.stack(np.meshgrid(*(np.arange(side + 1),) * 3, indexing="ij"), -1)
    truth = fine[tuple(np.moveaxis(places, -1, 0))]
    assert np.array_equal(truth < 0, bricks.value < 0)
    window = np.lib.stride_tricks.sliding_window_view(truth < 0, (2, 2, 2), (1, 2, 3)).reshape(
        *truth[:, 1:, 1:, 1:].shape, 8
    )
    crossing = window.any(-1) & ~window.all(-1)
    assert crossing.any()
    for shift in np.ndindex(2, 2, 2):
        part = (slice(None), *(slice(k, k + side) for k in shift))
        np.testing.assert_allclose(bricks.value[part][crossing], truth[part][crossing], atol=1e-6)
    assert field.queried < 0.6 * bricks.value.size


def test_what_is_known_is_the_field_and_what_is_not_is_interpolated() -> None:
    bricks = grown(4, crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE)), Field())
    corner = np.stack(np.unravel_index(bricks.cell, tuple(n - 1 for n in SHAPE)), -1)[:, None, None, None]
    place = (corner + np.stack(np.meshgrid(*(np.linspace(0, 1, 5),) * 3, indexing="ij"), -1))[..., ::-1]
    exact = Field()(place.reshape(-1, 3)).reshape(bricks.value.shape)
    right = np.abs(bricks.value - exact) < 1e-7
    assert right[bricks.known].all()
    assert right[~bricks.known].mean() < 0.2


def test_the_surface_is_followed_past_what_was_seen() -> None:
    all_cells = crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE))
    bricks = grown(2, all_cells[:1], Field())
    apart = np.array(np.unravel_index(bricks.cell, tuple(n - 1 for n in SHAPE))).T
    apart = apart - np.array(np.unravel_index(all_cells[0], tuple(n - 1 for n in SHAPE)))
    assert 5 < len(bricks.cell) <= 25
    assert np.abs(apart).sum(1).max() == 2


@pytest.mark.parametrize("rings", [0, 1])
def test_the_surface_is_followed_by_as_many_cells_as_told(rings: int) -> None:
    sdf = body_grid(PIN, ORIGIN, VOXEL, SHAPE).sdf.numpy()
    cell = crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE))[:1]
    place = np.array(
        np.unravel_index(grow_bricks(sdf, VOXEL, Bricks.none(2, sdf), cell, Field(), rings).cell, sdf[1:, 1:, 1:].shape)
    ).T
    assert np.abs(place - place[0]).sum(1).max() == rings


def test_the_atlas_begins_with_the_grid() -> None:
    grid = body_grid(PIN, ORIGIN, VOXEL, SHAPE).sdf
    bricks = grown(2, crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE)), Field())
    assert torch.equal(bricks.atlas[: SHAPE[0], : SHAPE[1], : SHAPE[2]], grid)


def test_points_in_bricks_get_the_trilinear_value_of_the_finer_grid() -> None:
    side = 4
    bricks = grown(side, crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE)), Field())
    assert len(bricks.cell) > ROW
    place = torch.from_numpy(np.stack(np.unravel_index(bricks.cell, tuple(n - 1 for n in SHAPE))[::-1], -1)).double()
    at_corner = place + 0.25 * torch.randint(0, 5, place.shape, generator=torch.Generator().manual_seed(0))
    rows, value = bricks.sample(at_corner)
    exact = PIN(VOXEL * at_corner[rows] + torch.tensor(ORIGIN))
    near = exact.abs() < 0.003
    assert near.sum() > 100
    assert (value - exact)[near].abs().max() < 1e-6
    rows, _ = bricks.sample(torch.zeros(3, 3).double())
    assert len(rows) == 0


def test_what_is_kept_is_not_evaluated_again() -> None:
    cells, field = crossed_cells(body_grid(PIN, ORIGIN, VOXEL, SHAPE)), Field()
    first = grown(2, cells[:40], field)
    queried = field.queried
    assert grown(2, cells[:40], field, first) is first
    assert field.queried == queried
    more = grown(2, cells, field, first)
    assert np.array_equal(more.cell[: len(first.cell)], first.cell)
    assert np.array_equal(more.value[: len(first.cell)], first.value)
    fresh = Field()
    grown(2, cells, fresh)
    assert field.queried - queried < fresh.queried


def test_a_surface_at_the_border_stays_in_the_grid() -> None:
    half = BodyGrid(np.zeros(3), VOXEL, lattice_points((4, 4, 4), VOXEL)[:, 1].view(4, 4, 4).float() - 0.03)
    cells, sdf = crossed_cells(half), half.sdf.numpy()
    field = lambda place: (VOXEL * place[:, 1] - 0.03).astype("f4")  # noqa: E731
    bricks = grow_bricks(sdf, VOXEL, Bricks.none(2, sdf), cells, field)
    assert np.array_equal(np.sort(bricks.cell), cells)
