"""Colours that earlier views of a pose tell: interpolated on one sheet of one limb, evaluated at edges and where nothing was seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.light import LIGHT_FRAMES, Irradiance, Light
from avatarrex.frame import DeferredFrame
from avatarrex.levels import COLOUR_TOLERANCE, LEVELS, level, moving
from avatarrex.pipeline import render_deferred
from avatarrex.shading.known_appearance import KnownAppearance
from avatarrex.shading.known_loops import CROWDED, TOLD, UNKNOWN, UNTOLD
from avatarrex.shading.shade import shade
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose

VIEW = Camera.orbit(10, 5, 1.0, 40, (0, 0, 0), 192, 192)
PIXEL = 0.0038
"""Metres between pixels of `VIEW` at its target."""


def ball(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Points of a sphere of 20 cm and their normals."""
    normal = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    normal = torch.nn.functional.normalize(normal, dim=-1)
    return 0.2 * normal, normal


def pattern(position: Tensor, slope: float, step: float) -> tuple[Tensor, Tensor]:
    """Five channels of an appearance, and a colour: linear in the place, with an edge at x = 0."""
    colour = 0.5 + slope * position + step * (position[:, :1] > 0)
    return torch.cat([2 * colour, position[:, :2]], 1), colour


def taught(slope: float = 1.0, step: float = 0.0, count: int = 100_000, side: int = 0) -> KnownAppearance:
    known, (position, normal) = KnownAppearance(5), ball(count, 0)
    known.add(position, normal, torch.full((count,), side), *pattern(position, slope, step))
    return known


def seen(count: int = 6000) -> tuple[Tensor, Tensor, Tensor]:
    """Points on the side of the ball that the view sees, with sides."""
    position, normal = ball(count, 1)
    shown = ((position - torch.as_tensor(VIEW.centre).float()) * normal).sum(-1) < -0.3
    return position[shown], normal[shown], torch.zeros(int(shown.sum()), dtype=torch.int64)


@pytest.mark.parametrize("step", [0.0, 0.02, 0.3])
@pytest.mark.parametrize("count", [20_000, 100_000, 500_000])
def test_loops_are_the_least_squares_of_the_reference(step: float, count: int) -> None:
    known, points = taught(3.0, step, count), seen(400)
    (mine, answer), (theirs, expected) = (
        known.seen_by(VIEW).interpolate(*points, 0.01, impl) for impl in ("auto", "reference")
    )
    assert (answer == expected).float().mean() > 0.99
    told = (answer == TOLD) & (expected == TOLD)
    assert told.any()
    torch.testing.assert_close(mine[told], theirs[told], atol=2e-4, rtol=1e-4)


def test_what_is_linear_is_told_and_exact() -> None:
    position, normal, side = seen()
    found, answer = taught().seen_by(VIEW).interpolate(position, normal, side, 0.01)
    assert (answer == TOLD).float().mean() > 0.9
    off = (found - pattern(position, 1.0, 0.0)[0])[answer == TOLD].abs()
    assert off.quantile(0.99) < 2e-3
    assert off.max() < 0.01, "the ball is not flat"


def test_an_edge_is_evaluated() -> None:
    position, normal, side = seen()
    found, answer = taught(step=0.3).seen_by(VIEW).interpolate(position, normal, side, 0.01)
    at_edge, beside = position[:, 0].abs() < 0.1 * PIXEL, position[:, 0].abs() > 2 * PIXEL
    assert not (answer[at_edge] == TOLD).any()
    assert (answer[beside] == TOLD).float().mean() > 0.9
    assert (found - pattern(position, 1.0, 0.3)[0])[answer == TOLD].abs().max() < 0.1


def test_known_points_are_returned_as_they_are() -> None:
    known, (position, normal) = taught(step=0.3), ball(100_000, 0)
    shown = ((position - torch.as_tensor(VIEW.centre).float()) * normal).sum(-1) < -0.3
    side = torch.zeros(int(shown.sum()), dtype=torch.int64)
    found, answer = known.seen_by(VIEW).interpolate(position[shown], normal[shown], side, 0.0)
    assert (answer == TOLD).all()
    assert torch.equal(found, pattern(position, 1.0, 0.3)[0][shown])


def test_nothing_is_told_far_beyond_what_is_known() -> None:
    """Known is the half of the ball left of x = 0: a plane fitted to points on one side alone would extrapolate."""
    (place, normal), known = ball(100_000, 0), KnownAppearance(5)
    left = place[:, 0] < 0
    known.add(
        place[left], normal[left], torch.zeros(int(left.sum()), dtype=torch.int64), *pattern(place[left], 1.0, 0.0)
    )
    position, normal, side = seen(400_000)

    def told(first: float, last: float, impl: str = "auto") -> Tensor:
        """Of points from `first` to `last` pixels beyond."""
        here = (position[:, 0] > first * PIXEL) & (position[:, 0] < last * PIXEL)
        return known.seen_by(VIEW).interpolate(position[here], normal[here], side[here], 0.05, impl)[1] == TOLD

    assert told(-2, -1).float().mean() > 0.9
    assert len(told(0.8, 1.4)) > 500
    assert not told(0.8, 1.4).any()
    assert (told(0.4, 0.8) == told(0.4, 0.8, "reference")).float().mean() > 0.995


def test_another_limb_and_another_sheet_tell_nothing() -> None:
    position, normal, side = seen()
    assert not (taught(side=1).seen_by(VIEW).interpolate(position, normal, side, 0.01)[1] == TOLD).any()
    across = torch.nn.functional.normalize(torch.linalg.cross(normal, torch.tensor([[0.0, 1.0, 0.0]]), dim=-1), dim=-1)
    assert not (taught().seen_by(VIEW).interpolate(position, across, side, 0.01)[1] == TOLD).any()


def test_the_back_tells_nothing_of_the_front() -> None:
    known, (position, normal) = KnownAppearance(5), ball(100_000, 0)
    hidden = ((position - torch.as_tensor(VIEW.centre).float()) * normal).sum(-1) > 0
    known.add(
        position[hidden],
        normal[hidden],
        torch.zeros(int(hidden.sum()), dtype=torch.int64),
        *pattern(position[hidden], 1.0, 0),
    )
    assert (known.seen_by(VIEW).interpolate(*seen(), 0.01)[1] == UNKNOWN).all()


def test_where_it_is_crowded_no_more_is_kept() -> None:
    known, (position, normal, side) = taught(step=0.3, count=1_800_000), seen()
    _, answer = known.seen_by(VIEW).interpolate(position, normal, side, 0.01)
    middle = (position[:, 0].abs() < 0.1 * PIXEL) & (normal @ torch.as_tensor(VIEW.centre).float() > 0.8)
    assert 1_800_000 / (4 * torch.pi * 0.2**2) * 9 * PIXEL**2 > CROWDED
    assert (answer[middle] == UNTOLD).all()
    assert middle.any()


def test_what_a_view_does_not_see_is_forgotten_when_there_is_too_much() -> None:
    known, (position, normal) = KnownAppearance(5, most=2000), ball(3000, 0)
    side = torch.zeros(3000, dtype=torch.int64)
    known.add(position, normal, side, *pattern(position, 1.0, 0.0))
    before = KnownAppearance(5)
    before.add(position, normal, side, *pattern(position, 1.0, 0.0))
    (mine, answer), (theirs, expected) = (each.seen_by(VIEW).interpolate(*seen(), 0.05) for each in (known, before))
    assert known.count < 2000 < before.count == 3000
    assert torch.equal(answer, expected)
    assert torch.equal(mine[answer == TOLD], theirs[answer == TOLD])


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


STILL = Signals.rest()


def turned(
    avatar: Avatar,
    azimuth: float,
    before: DeferredFrame | None,
    tolerance: float = COLOUR_TOLERANCE,
    signals: Signals = STILL,
) -> DeferredFrame:
    camera = Camera.orbit(azimuth, 5, 1.0, 40, (0, 0.3, 0), 256, 256)
    settings = replace(
        moving(level("balanced")), raycast="torch", antialias=False, part_voxel=0.01, colour_tolerance=tolerance
    )
    return render_deferred(avatar, signals, camera, settings, before)


def test_a_view_that_turns_is_as_without_reuse_to_50_db(avatar: Avatar) -> None:
    assert not any(settings.colour_tolerance for settings in LEVELS.values())
    frame = turned(avatar, 0, turned(avatar, -5, None))
    for azimuth in (5, 10):
        before, frame = frame, turned(avatar, azimuth, frame)
        exact = turned(avatar, azimuth, frame, 0.0)
        assert exact.counters["body_pixels"] > 0.9 * exact.counters["pixels_shaded"] > 0
        assert frame.counters["body_pixels"] < 0.6 * exact.counters["body_pixels"]
        noise = (frame.image - exact.image)[frame.pointmap.hit][:, :3].square().mean()
        assert -10 * noise.log10() > 50
        alone = turned(avatar, azimuth, None, 0.0)
        assert torch.equal(exact.image, alone.image), "whatever was before, without a tolerance"
        again = turned(avatar, azimuth, exact)
        assert again.shading is exact.shading, "an exact picture is good enough"
    assert before.shading.known is frame.shading.known


def test_a_pose_that_is_seen_once_is_not_kept(avatar: Avatar) -> None:
    assert turned(avatar, 0, None).shading.known is None


@pytest.mark.parametrize("frame", LIGHT_FRAMES)
def test_who_turns_in_the_light_of_the_world_is_lit_anew(avatar: Avatar, frame: str) -> None:
    """Known colours and the last picture are of another light; one that turns along leaves both."""
    here = replace(avatar, light=Light(frame))
    torch.nn.init.normal_(here.light.harmonics, 0.0, 0.2, generator=torch.Generator().manual_seed(4))
    before = turned(here, 40, turned(here, 35, turned(here, 30, None)))
    half = Signals.rest().replace(global_orient=np.array([0.0, 0.7, 0.0]))
    after, alone = (turned(here, 40 + np.rad2deg(0.7), then, signals=half) for then in (before, None))
    hit = alone.pointmap.hit & before.pointmap.hit
    noise = (after.image - alone.image)[hit][:, :3].square().mean()
    assert -10 * noise.log10() > 50
    change = (after.image - before.image)[hit][:, :3].abs().mean()
    assert change > 0.02 if frame == "world" else change < 0.002
    assert torch.equal(turned(here, 40, before).image, before.image)
    dark = Irradiance(torch.zeros(8, 3))
    again, anew = (
        shade(here, before.surface, dark, Counters(), kept, before.settings) for kept in (before.shading, None)
    )
    assert torch.equal(again.image, anew.image), "the same point map in another light"
    assert not torch.equal(again.image, before.image)


@pytest.mark.parametrize("pose", ["stand", "hands_on_hips"])
def test_a_hand_or_a_face_that_moves_leaves_the_other_pixels(avatar: Avatar, pose: str) -> None:
    """They are as if all were shaded, to the last digit; a hand that rests on the hip decides which limb the cloth beneath it is on."""
    camera = Camera.orbit(10, 5, 2.2, 40, (0, 0, 0), 160, 160)
    settings = replace(level("balanced"), part_voxel=0.005)
    still = Signals.rest().replace(body_pose=named_pose(pose))
    before = render_deferred(avatar, still, camera, settings)
    smile = still.replace(expression=named_expression("smile"))
    for signals in (smile, smile.replace(left_hand_pose=0.7 * named_hand("fist", "left"))):
        frame = render_deferred(avatar, signals, camera, settings, before)
        whole = render_deferred(avatar, signals, camera, settings)
        assert 0 < frame.counters["pixels_shaded"] < 0.35 * whole.counters["pixels_shaded"]
        torch.testing.assert_close(frame.image, whole.image, atol=2e-6, rtol=0)
        before = frame


def test_a_pixel_whose_share_changed_or_in_a_contact_box_of_a_moved_hand_is_shaded(avatar: Avatar) -> None:
    """The picture before is poisoned: what is kept of it shows."""
    camera = Camera.orbit(10, 5, 2.2, 40, (0, 0, 0), 160, 160)
    settings = replace(level("balanced"), part_voxel=0.005)
    still = Signals.rest().replace(body_pose=named_pose("hands_on_hips"))
    frame = render_deferred(avatar, still, camera, settings)
    moved = render_deferred(
        avatar, still.replace(left_hand_pose=0.1 * named_hand("fist", "left")), camera, settings, frame
    )
    poisoned = replace(frame.shading, unmixed=torch.full_like(frame.shading.unmixed, 7.0))
    kept = (shade(avatar, moved.surface, poisoned.light, Counters(), poisoned, settings).unmixed == 7).all(-1)
    (box,) = (box for box in moved.surface.volume.sdf.parts if box.name == "left_hand")
    assert box.contact
    there = box.holds(moved.pointmap.position.reshape(-1, 3)).reshape(kept.shape)
    assert (there & (moved.pointmap.position == frame.pointmap.position).all(-1) & moved.pointmap.hit).sum() > 20
    assert kept.sum() > 1000
    assert not (kept & there).any()
    row, column = (int(index[0]) for index in torch.nonzero(kept, as_tuple=True))
    share = moved.pointmap.part_weight.clone()
    share[row, column, 2] += 0.01
    then = replace(poisoned, surface=replace(moved.surface, pointmap=replace(moved.pointmap, part_weight=share)))
    again = (shade(avatar, moved.surface, then.light, Counters(), then, settings).unmixed == 7).all(-1)
    assert not again[row, column]
    assert again.sum() == (moved.pointmap.coverage > 0).sum() - 1


def test_a_coarse_picture_is_evaluated(avatar: Avatar) -> None:
    """A pixel of 6 mm: known points are farther apart than the texels of a pattern."""
    settings, frame = replace(moving(level("fast")), raycast="torch", part_voxel=0.01), None
    for azimuth in (0, 5, 10):
        camera = Camera.orbit(azimuth, 5, 2.1, 40, (0, 0, 0), 256, 256)
        frame = render_deferred(avatar, Signals.rest(), camera, settings, frame)
    exact = render_deferred(avatar, Signals.rest(), camera, replace(settings, colour_tolerance=0.0))
    assert frame
    assert torch.equal(frame.image, exact.image)
