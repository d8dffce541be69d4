"""Sampling a stored volume: the composed field at points."""

import numpy as np
import pytest
import torch

from avatarrex.reference.solids import body_grid, part_box, rotation, sphere
from avatarrex.volume.sdf_volume import Contact, PartBox, SdfVolume, distance, sample

POINTS = torch.rand(4000, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64) * 0.36 + 0.02


def linear(p):
    return p @ torch.tensor([0.6, -0.3, 0.2], dtype=p.dtype) - 0.1


def plane_body():
    return body_grid(linear, (0, 0, 0), 0.02, (21, 21, 21))


def placed(degrees=30.0, at=(0.1, 0.12, 0.08)):
    place = np.eye(4)
    place[:3, :3] = rotation(2, degrees) @ rotation(0, 15)
    place[:3, 3] = at
    return place


def hand(place=None, contact=None, name="left_hand"):
    centre = (np.asarray(placed() if place is None else place) @ [0.06, 0.06, 0.06, 1])[:3]
    box = part_box(
        name,
        sphere(centre.tolist(), 0.04),
        lambda p: torch.full_like(p[:, 0], 0.7),
        placed() if place is None else place,
        0.005,
        (25,) * 3,
    )
    return PartBox(box.name, box.box_from_root, box.voxel, box.field, contact)


def test_a_linear_body_is_exact_and_bounds_the_step():
    got = sample(SdfVolume(plane_body()), POINTS)
    torch.testing.assert_close(got.composed.sdf, linear(POINTS), atol=1e-7, rtol=0)
    assert torch.equal(got.step, got.composed.sdf.abs())
    assert (got.composed.part_weight == 0).all()
    assert (got.scale == 0.02).all()


def test_outside_the_body_grid_the_distance_to_it_is_added():
    beyond = torch.tensor([[0.5, 0.2, 0.2], [0.2, 0.2, -0.3], [-0.3, 0.2, -0.4]], dtype=torch.float64)
    nearest = beyond.clamp(0, 0.4)
    expected = linear(nearest) + (beyond - nearest).norm(dim=-1)
    torch.testing.assert_close(sample(SdfVolume(plane_body()), beyond).composed.sdf, expected, atol=1e-7, rtol=0)


def test_a_part_blends_inside_its_box_only():
    box = hand()
    got = sample(SdfVolume(plane_body(), (box,)), POINTS)
    local = (POINTS @ torch.as_tensor(box.box_from_root[:3, :3]).T) + torch.as_tensor(box.box_from_root[:3, 3])
    inside = ((local >= 0) & (local <= 0.12)).all(1)
    part = (local - 0.06).norm(dim=1) - 0.04
    blended = inside & (part < 0.02)
    assert 20 < int(blended.sum()) < int(inside.sum()) < 2000
    # A 5 mm grid of a 4 cm ball is off by at most 3 h² / (8 · 2 cm) where the ball's distance is sampled.
    expected = 0.7 * part + 0.3 * linear(POINTS)
    torch.testing.assert_close(got.composed.sdf[blended], expected[blended], atol=5e-4, rtol=0)
    torch.testing.assert_close(
        got.composed.part_weight[blended, 0], torch.full_like(part[blended], 0.7), atol=1e-6, rtol=0
    )
    assert (got.composed.part_weight[~inside] == 0).all()
    torch.testing.assert_close(got.composed.sdf[~inside], linear(POINTS)[~inside], atol=1e-7, rtol=0)
    # No step from outside leaps over the box; the literal step |s| would.
    into = torch.maximum(-local, local - 0.12).clamp(min=0).norm(dim=1)
    assert (got.step[~inside] <= into[~inside] + 0.005 + 1e-9).all()
    assert (linear(POINTS).abs()[~inside] > into[~inside] + 0.005).any()


def test_a_rigid_motion_of_everything_changes_nothing():
    rotation_ = torch.as_tensor(rotation(2, 90))
    body = plane_body()
    # A quarter turn about z maps the lattice onto itself: x' = -y, y' = x.
    turned = body_grid(lambda p: linear(p @ rotation_), (-0.4, 0, 0), 0.02, (21, 21, 21))
    motion = np.eye(4)
    motion[:3, :3] = rotation(2, 90)
    one = sample(SdfVolume(body, (hand(),)), POINTS)
    two = sample(SdfVolume(turned, (hand(motion @ placed()),)), POINTS @ rotation_.T)
    torch.testing.assert_close(one.composed.sdf, two.composed.sdf, atol=1e-6, rtol=0)
    torch.testing.assert_close(one.step, two.step, atol=1e-6, rtol=0)


def test_contact_replaces_the_body_and_keeps_the_other_limb():
    body = plane_body()
    block = torch.stack([torch.full((21, 21, 21), 0.03), torch.full((21, 21, 21), -0.01)], -1)
    first = np.array([2, 3, 1])
    contact = Contact(first, block[:18, :17, :19].contiguous())
    got = sample(SdfVolume(body, (hand(contact=contact),)), POINTS)
    plain = sample(SdfVolume(body, (hand(),)), POINTS)
    clamped = got.composed.sdf != plain.composed.sdf
    assert clamped.any()
    assert (got.composed.sdf[clamped] <= -0.01 + 1e-9).all()


def test_the_distance_alone_is_the_same_to_the_bit():
    points = torch.cat([POINTS, 3 * POINTS - 0.5])
    block = torch.stack([torch.full((21, 21, 21), 0.03), torch.full((21, 21, 21), -0.01)], -1)
    contact = Contact(np.array([2, 3, 1]), block[:18, :17, :19].contiguous())
    other = hand(placed(10, (0.15, 0.1, 0.12)), name="right_hand")
    for parts in ((), (hand(),), (hand(contact=contact), other)):
        volume = SdfVolume(plane_body(), parts)
        for some in (points, points.float(), points[:0], points + 5):
            assert torch.equal(distance(volume, some), sample(volume, some).composed.sdf)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_is_kept_and_no_point_is_fine(dtype):
    volume = SdfVolume(plane_body(), (hand(),))
    assert sample(volume, POINTS.to(dtype)).composed.sdf.dtype == dtype
    assert sample(volume, torch.zeros(0, 3, dtype=dtype)).composed.sdf.shape == (0,)
