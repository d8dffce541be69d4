"""Pixels in which one sheet of the surface hides another: how much of them shows which, and whose colour that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.camera import Camera
from avatarrex.pointmap.occlusion_edges import OcclusionEdges
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import available, raycast
from avatarrex.reference.solids import body_grid, capsule, sphere, union
from avatarrex.volume.sdf_volume import SdfVolume

Point = tuple[float, float, float]
BALLS = SdfVolume(
    body_grid(union(sphere((0.3, 0.3, 0.48), 0.1), sphere((0.3, 0.3, -0.2), 0.45)), (0, 0, -0.2), 0.02, (41, 31, 31))
)
"""A small ball in the middle of the picture before a large one that fills it."""


def view(size: int, azimuth: float = 12.0) -> Camera:
    return Camera.orbit(azimuth, 7, 2.0, 14, (0.3, 0.3, 0.3), size, size)


def near(camera: Camera, point: PointMap) -> torch.Tensor:
    """Which hits are on the small ball."""
    middle = torch.tensor([0.3, 0.3, 0.48])
    return ((point.position - middle).norm(dim=-1) < 0.11) & point.hit


def test_shares_are_those_of_a_supersampled_image(impl: str) -> None:
    camera = view(48)
    one, fine = raycast(BALLS, camera, impl), raycast(BALLS, camera.resized(192, 192), impl, antialias=False)
    on_ball = near(camera, one)
    expected = torch.nn.functional.avg_pool2d(near(camera, fine).float()[None, None], 4)[0, 0].flatten()
    found = on_ball.float().flatten()
    edges = one.edges
    assert 50 < len(edges.pixel) < 200
    assert (one.coverage.flatten()[edges.pixel] == 1).all()
    assert (on_ball.flatten()[edges.pixel] != on_ball.flatten()[edges.beside]).all()
    sign = 1 - 2 * found[edges.pixel]
    found[edges.pixel] += sign * edges.share
    assert (found - expected).abs().max() <= 2 / 16 + 1e-6
    assert (found != expected).float().mean() < 0.01
    assert (expected * (1 - expected) > 0).sum() > 50


@pytest.mark.parametrize("rim", [0.0, 0.35, 0.7])
@pytest.mark.parametrize("ends", [((0.0, 0.3, 0.45), (0.6, 0.3, 0.45)), ((0.3, 0.0, 0.45), (0.3, 0.6, 0.45))])
def test_straight_rims_are_smoothed_on_both_sides(impl: str, ends: tuple[Point, Point], rim: float) -> None:
    """A level rod and an upright one before a ball, moved by `rim` of a pixel: pixels there have one neighbour on the other sheet."""
    rod, ball = capsule(*ends, 0.052), sphere((0.3, 0.3, -0.2), 0.45)
    volume = SdfVolume(body_grid(union(rod, ball), (0, 0, -0.2), 0.02, (41, 31, 31)))
    camera = Camera.orbit(0, 0, 2.0, 14, (0.3, 0.3, 0.3), 48, 48).cropped(14, 14, 20, 20)
    camera = replace(camera, intrinsics=camera.intrinsics + rim * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]]))
    one, fine = raycast(volume, camera, impl), raycast(volume, camera.resized(80, 80), impl, antialias=False)
    on_rod, rod_finely = one.depth < 1.86, fine.depth < 1.86
    expected = torch.nn.functional.avg_pool2d(rod_finely.float()[None, None], 4)[0, 0].flatten()
    found = on_rod.float().flatten()
    found[one.edges.pixel] += (1 - 2 * found[one.edges.pixel]) * one.edges.share
    assert 0.3 < expected.mean() < 0.8
    assert (found - expected).abs().max() <= 1 / 16 + 1e-6


def test_a_leaning_sheet_is_one(impl: str) -> None:
    """A rod that goes away from the eye by 45°, and turns away at its rims: 3 pixels wide, their depths are less than the gap apart."""
    rod = SdfVolume(body_grid(capsule((0.3, 0.3, -0.1), (0.3, 0.3, 0.7), 0.05), (0, 0, 0), 0.02, (31, 31, 31)))
    one = raycast(rod, Camera.orbit(45, 0, 2.0, 20, (0.3, 0.3, 0.3), 48, 48), impl)
    assert one.coverage.sum() > 100
    assert not len(one.edges.pixel)


def test_neighbours_touch(impl: str) -> None:
    edges = raycast(BALLS, view(48).resized(40, 60), impl).edges
    apart = torch.stack([edges.beside % 40 - edges.pixel % 40, edges.beside // 40 - edges.pixel // 40], 1)
    assert (apart.abs().sum(1) == 1).all()
    assert {tuple(step) for step in apart.tolist()} == {(-1, 0), (1, 0), (0, -1), (0, 1)}


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
@pytest.mark.parametrize("size", [61, 88])
def test_shaders_find_what_tensors_do(man: SdfVolume, size: int) -> None:
    """Sub-positions that graze may differ."""
    camera = Camera.orbit(75, 10, 2.6, 40, (0, 0, 0), size, size)
    shares = []
    for impl in ("gl", "torch"):
        edges = raycast(man, camera, impl).edges
        share = torch.zeros(size * size, 2)
        share[edges.pixel, 0], share[edges.pixel, 1] = edges.share, edges.beside.float()
        shares.append(share)
    both = (shares[0][:, 0] > 0) & (shares[1][:, 0] > 0)
    assert int(both.sum()) > 10
    assert (shares[0][:, 0] - shares[1][:, 0]).abs().max() <= 2 / 16 + 1e-6
    assert (shares[0] != shares[1]).any(1).float().mean() < 0.002


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
@pytest.mark.parametrize("field", [8, 3])
def test_close_sheets_are_told_apart(field: float) -> None:
    """Two fingers that touch, pixels of 0.7 and 0.3 mm: a sub-ray's hit has to be as exact as a gap of four pixels is small."""
    fingers = union(
        capsule((0.1, 0.3, 0.36), (0.5, 0.3, 0.36), 0.03), capsule((0.1, 0.27, 0.3), (0.5, 0.27, 0.3), 0.03)
    )
    volume = SdfVolume(body_grid(fingers, (0, 0, 0), 0.02, (31, 31, 31)))
    camera, shares = Camera.orbit(10, 20, 1.0, field, (0.3, 0.29, 0.34), 192, 192), []
    for impl in ("gl", "torch"):
        edges = raycast(volume, camera, impl).edges
        shares.append(torch.zeros(192 * 192).index_copy(0, edges.pixel, edges.share))
    assert int((shares[1] > 0).sum()) > 50
    assert ((shares[0] - shares[1]).abs() > 2 / 16 + 1e-6).sum() <= 5  # rims that are met for less than a step


def test_colours_are_mixed_by_shares() -> None:
    image = torch.zeros(2, 3, 4)
    image[0, 0] = torch.tensor([0.8, 0.4, 0.0, 1.0])
    image[0, 1] = torch.tensor([0.1, 0.1, 0.3, 0.5])  # a neighbour that is half covered: its colour is (0.2, 0.2, 0.6)
    image[1, 2] = torch.tensor([0.3, 0.2, 0.1, 0.5])
    edges = OcclusionEdges(torch.tensor([0, 5]), torch.tensor([1, 0]), torch.tensor([0.25, 0.5]))
    mixed = edges.blended(image)
    torch.testing.assert_close(mixed[0, 0], torch.tensor([0.65, 0.35, 0.15, 1.0]))
    torch.testing.assert_close(
        mixed[1, 2], torch.tensor([0.35, 0.2, 0.05, 0.5])
    )  # of colours before anything was mixed
    mixed[0, 0], mixed[1, 2] = image[0, 0], image[1, 2]
    assert torch.equal(mixed, image)
    assert OcclusionEdges.none().blended(image) is image


def test_some_pixels_and_the_others_are_all() -> None:
    edges = OcclusionEdges(torch.tensor([0, 5, 2]), torch.tensor([1, 4, 1]), torch.tensor([0.25, 0.5, 0.75]))
    wanted = torch.tensor([[True, False, False], [False, False, True]])
    some, others = edges.among(wanted), edges.among(~wanted)
    assert some.pixel.tolist() == [0, 5]
    assert some.beside.tolist() == [1, 4]
    whole = others.joined(some)
    assert whole.pixel.tolist() == [2, 0, 5]
    assert whole.share.tolist() == [0.75, 0.25, 0.5]
    assert whole.beside.tolist() == [1, 1, 4]


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
def test_pixels_that_are_not_wanted_have_none() -> None:
    """The columns end within a tile, and where the ball's rim is seen."""
    camera = view(48)
    whole = raycast(BALLS, camera, "gl")
    only = torch.zeros_like(whole.hit)
    only[:, :21] = True
    some, wanted = raycast(BALLS, camera, "gl", only=only).edges, whole.edges.among(only)
    assert 10 < len(wanted.pixel) < len(whole.edges.pixel) - 10
    assert (wanted.pixel % 48 == 20).any()
    orders = some.pixel.argsort(), wanted.pixel.argsort()
    for mine, theirs in zip(vars(some).values(), vars(wanted).values()):
        assert torch.equal(mine[orders[0]], theirs[orders[1]])


def test_without_antialiasing_there_are_none(impl: str) -> None:
    assert not len(raycast(BALLS, view(48), impl, antialias=False).edges.pixel)
    assert not len(raycast(BALLS, view(48), impl, march="fixed").edges.pixel)
