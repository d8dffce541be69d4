"""Ray casters on a volume with bricks: the float64 walk's hits, and a truer surface."""

import dataclasses

import numpy as np
import pytest
import torch
from raycast_cases import agree

from avatarrex.camera import Camera
from avatarrex.pointmap.raycast import raycast
from avatarrex.pointmap.visible_cells import visible_cells
from avatarrex.reference.solids import body_grid, capsule, part_box, rotation, sphere, union
from avatarrex.volume.bricks import Bricks, grow_bricks
from avatarrex.volume.sdf_volume import SdfVolume

FIGURE = union(sphere((0, 0, 0), 0.15), capsule((-0.2, 0.11, 0), (0.2, 0.2, 0.05), 0.014))
GRID = ((-0.3, -0.3, -0.3), 0.02, (31, 31, 31))
CAMERA = Camera.orbit(20, 15, 1.2, 28, (0, 0, 0), 96, 96)


def figure(boxes: bool = False) -> SdfVolume:
    """A ball and a stick, with a box about one end of the stick if `boxes`."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = rotation(1, 25), (0.05, 0.1, -0.06)
    box = part_box("left_hand", FIGURE, _ramp, place, 0.005, (24, 30, 40))
    return SdfVolume(body_grid(FIGURE, *GRID), (box,) if boxes else ())


def _ramp(p: torch.Tensor) -> torch.Tensor:
    return ((p[:, 0] - 0.1) / 0.04).clamp(0, 1)


def bricked(volume: SdfVolume, side: int, camera: Camera = CAMERA) -> SdfVolume:
    grid = volume.body
    cells, _ = visible_cells(volume, camera, "torch")

    def exact(place: np.ndarray) -> np.ndarray:
        return FIGURE(torch.from_numpy(grid.origin + grid.voxel * place)).float().numpy()

    sdf = grid.sdf.numpy()
    bricks = grow_bricks(sdf, grid.voxel, Bricks.none(side, sdf), cells, exact)
    return SdfVolume(dataclasses.replace(grid, bricks=bricks), volume.parts)


def surface_error(volume: SdfVolume, camera: Camera) -> torch.Tensor:
    """Metres that hits lie off the exact figure."""
    one = raycast(volume, camera, "torch", antialias=False)
    return FIGURE(one.position[one.hit].double()).abs()


@pytest.mark.parametrize("boxes", [False, True], ids=["alone", "with a box"])
@pytest.mark.parametrize("side", [2, 4])
def test_casters_walk_bricks_as_the_reference_does(impl: str, side: int, boxes: bool) -> None:
    agree(bricked(figure(boxes), side), CAMERA, impl)


def test_bricks_bring_the_surface_to_the_exact_one() -> None:
    coarse, fine = (surface_error(volume, CAMERA) for volume in (figure(), bricked(figure(), 4)))
    assert coarse.max() > 5e-4
    assert fine.quantile(0.99) < coarse.quantile(0.99) / 6


def test_what_a_large_view_hits_is_in_bricks() -> None:
    close = Camera.orbit(20, 15, 1.2, 28, (0, 0, 0), 400, 400)
    volume = bricked(figure(), 2, close)
    one = raycast(volume, close, "torch", antialias=False)
    place = (one.position[one.hit].double() - torch.as_tensor(volume.body.origin)) / volume.body.voxel
    assert volume.body.bricks is not None
    rows, _ = volume.body.bricks.sample(place)
    assert len(place) > 10_000
    assert len(place) - len(rows) < 1e-3 * len(place)


def test_a_view_without_the_person_sees_no_cell() -> None:
    away = Camera.orbit(0, 0, 2, 30, (5, 0, 0), 32, 32)
    cells, found = visible_cells(figure(), away, "torch")
    assert len(cells) == 0
    assert not found.hit.any()
    assert raycast(bricked(figure(), 2, away), CAMERA, "torch").hit.any()


def test_a_fixed_march_is_near_and_not_exact(impl: str) -> None:
    volume = figure(boxes=True)
    exact, plain = raycast(volume, CAMERA, impl, antialias=False), raycast(volume, CAMERA, impl, march="fixed")
    both = exact.hit & plain.hit
    assert (exact.hit != plain.hit).sum() < 0.01 * both.sum()
    apart = (exact.depth - plain.depth)[both].abs()
    assert 1e-6 < apart.median() < 1e-3
    assert set(plain.coverage.unique().tolist()) == {0.0, 1.0}
    assert plain.counters["ray_steps"] > 2 * exact.counters["ray_steps"]
