"""Hands and face that are off screen are not built, and the picture is the same. Uses the packaged avatar."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.frame import Frame
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import build_volume
from avatarrex.volume.off_screen import off_screen_parts
from avatarrex.volume.part_box import coarse_lattice

SETTINGS = RenderSettings(raycast="torch", part_voxel=0.01)
STAND = Signals.rest().replace(body_pose=named_pose("stand"))
FRONT = Camera.orbit(0, 5, 2.8, 40, (0, -0.05, 0), 64, 64)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


@pytest.fixture(scope="module")
def posed(avatar: Avatar) -> PosedPerson:
    return pose_person(avatar.person, STAND, Counters(), None)


def near(posed: PosedPerson, name: str, azimuth: float = 0.0) -> Camera:
    """A close view of a part."""
    return Camera.orbit(azimuth, 0, 0.5, 25, tuple(posed.root_from_part(name)[:3, 3]), 64, 64)


def whole(avatar: Avatar, signals: Signals, camera: Camera, settings: RenderSettings = SETTINGS) -> Frame:
    """The frame with every part built before the camera is known."""
    seen_all = render_frame(avatar, signals, FRONT, replace(settings, bricks=0))
    assert set(seen_all.volume.parts) == set(PARTS)
    return render_frame(avatar, signals, camera, settings, seen_all)


@pytest.mark.parametrize("name", PARTS)
def test_the_box_is_the_lattice_that_is_judged_and_contains_the_bounds(
    avatar: Avatar, posed: PosedPerson, name: str
) -> None:
    volume = build_volume(avatar, posed, SETTINGS, Counters(), None)
    low, high = avatar.parts[name].bounds(posed.parts[name])
    corners = volume.parts[name].box.lattice.corners()
    judged = coarse_lattice(avatar.parts[name], posed.parts[name], SETTINGS.part_voxel).corners()
    np.testing.assert_allclose(corners, judged, atol=1e-12)
    assert (corners.min(0) <= low + 1e-9).all()
    assert (corners.max(0) >= high - 1e-9).all()


@pytest.mark.parametrize("bricks", [0, 4])
def test_a_close_view_of_a_hand_builds_that_hand_alone(avatar: Avatar, posed: PosedPerson, bricks: int) -> None:
    camera, settings = near(posed, "left_hand"), replace(SETTINGS, bricks=bricks)
    frame = render_frame(avatar, STAND, camera, settings)
    assert set(frame.volume.parts) == {"left_hand"}
    assert frame.counters["face_evaluations"] == frame.counters["unet_runs"] == 0
    same = whole(avatar, STAND, camera, settings)
    torch.testing.assert_close(frame.image, same.image, rtol=0, atol=2e-3)
    assert torch.equal(frame.pointmap.hit, same.pointmap.hit)


def test_what_comes_into_view_is_built_then_and_kept(avatar: Avatar, posed: PosedPerson) -> None:
    hand = render_frame(avatar, STAND, near(posed, "left_hand"), SETTINGS)
    front = render_frame(avatar, STAND, FRONT, SETTINGS, hand)
    assert set(front.volume.parts) == set(PARTS)
    assert front.counters["voxels_evaluated"] == 0
    assert front.volume.parts["left_hand"] is hand.volume.parts["left_hand"]
    torch.testing.assert_close(front.image, render_frame(avatar, STAND, FRONT, SETTINGS).image, rtol=0, atol=1e-6)
    again = render_frame(avatar, STAND, near(posed, "left_hand"), SETTINGS, front)
    assert again.volume is front.volume


def test_an_expression_that_nobody_sees_costs_nothing(avatar: Avatar, posed: PosedPerson) -> None:
    camera = near(posed, "left_hand")
    before = render_frame(avatar, STAND, camera, SETTINGS)
    smiling = render_frame(avatar, STAND.replace(expression=named_expression("smile")), camera, SETTINGS, before)
    assert smiling.image is before.image
    assert {name for name, count in smiling.counters.items() if count} == {"templates_posed"}


@pytest.mark.parametrize("name", PARTS)
def test_a_part_partly_on_screen_is_built(avatar: Avatar, posed: PosedPerson, name: str) -> None:
    """The part's middle lies on the picture's left rim: half of its box is off screen."""
    camera = near(posed, name)
    shifted = replace(camera, intrinsics=camera.intrinsics - np.array([[0, 0, 32.0], [0, 0, 0], [0, 0, 0]]))
    assert name not in off_screen_parts(avatar, posed, shifted, SETTINGS)
    away = replace(camera, intrinsics=camera.intrinsics - np.array([[0, 0, 200.0], [0, 0, 0], [0, 0, 0]]))
    assert name in off_screen_parts(avatar, posed, away, SETTINGS)
    assert not off_screen_parts(avatar, posed, away, replace(SETTINGS, everywhere=True))


def test_a_part_that_the_body_hides_is_built(avatar: Avatar) -> None:
    back = Camera.orbit(180, 0, 2.8, 40, (0, -0.05, 0), 96, 96)
    assert set(render_frame(avatar, STAND, back, SETTINGS).volume.parts) == set(PARTS)


def test_a_hand_s_pose_off_screen_is_built_when_it_comes_into_view(avatar: Avatar, posed: PosedPerson) -> None:
    face = near(posed, "face")
    before = render_frame(avatar, STAND, FRONT, SETTINGS)
    fist = STAND.replace(left_hand_pose=named_hand("fist", "left"))
    away = render_frame(avatar, fist, face, SETTINGS, before)
    assert away.counters["hand_distances"] == 0
    back = render_frame(avatar, fist, FRONT, SETTINGS, away)
    assert back.counters["hand_distances"] > 0
    torch.testing.assert_close(back.image, render_frame(avatar, fist, FRONT, SETTINGS).image, rtol=0, atol=1e-6)
