"""Hands and face that a view does not show are not built, and the picture is the same. Uses the packaged avatar."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar, load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pipeline import Frame, RenderSettings, render_frame
from avatarrex.pointmap.raycast import raycast
from avatarrex.pointmap.visibility import Bounds
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import build_volume
from avatarrex.volume.sdf_volume import PARTS

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
    """The frame with every part built before the camera is asked."""
    seen_all = render_frame(avatar, signals, FRONT, replace(settings, bricks=0))
    assert set(seen_all.volume.parts) == set(PARTS)
    return render_frame(avatar, signals, camera, settings, seen_all)


@pytest.mark.parametrize("name", PARTS)
def test_bounds_hold_the_box(avatar: Avatar, posed: PosedPerson, name: str) -> None:
    volume = build_volume(avatar, posed, SETTINGS, Counters(), None)
    bounds, part = Bounds.of(avatar, posed, name, SETTINGS.part_voxel), volume.parts[name]
    corners = part.corners()
    assert (bounds.low <= corners.min(0) + 1e-9).all()
    assert (bounds.high >= corners.max(0) - 1e-9).all()
    assert (bounds.high - bounds.low < np.ptp(corners, axis=0) + 0.16).all()


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


def seen_from_behind(shoulder: tuple[float, ...], elbow: tuple[float, ...]) -> tuple[Signals, RenderSettings, Camera]:
    """A pose of the left arm whose hand the torso hides."""
    pose = named_pose("stand").copy()
    pose[15], pose[17] = shoulder, elbow
    back = Camera.orbit(180, 0, 2.8, 40, (0, -0.05, 0), 96, 96)
    return Signals.rest().replace(body_pose=pose), replace(SETTINGS, part_voxel=0.005), back


def test_a_hidden_hand_whose_box_the_torso_shares_is_built(avatar: Avatar) -> None:
    """At the belly: with contact the body differs in all of the box, in what the picture shows of it, too."""
    signals, settings, back = seen_from_behind((0.74, -1.28, 0.3), (0.06, -1.97, 0.09))
    frame = render_frame(avatar, signals, back, settings)
    assert "left_hand" in frame.volume.parts
    assert not (frame.pointmap.part_weight[..., 0] > 0).any()


def test_a_hand_that_the_body_hides_is_not_built(avatar: Avatar) -> None:
    """The left arm held forward, its hand before the chest, seen from behind."""
    signals, settings, back = seen_from_behind((0.64, -1.42, 1.31), (0.07, -1.29, -0.09))
    frame = render_frame(avatar, signals, back, settings)
    assert set(frame.volume.parts) == {"right_hand", "face"}
    same = render_frame(avatar, signals, back, settings, whole(avatar, signals, FRONT, settings))
    assert "left_hand" in same.volume.parts
    assert not (same.pointmap.part_weight[..., 0] > 0).any()
    torch.testing.assert_close(frame.image, same.image, rtol=0, atol=1e-6)
    idle = render_frame(avatar, signals, back, settings, frame)
    assert not any(idle.counters.values())
    assert idle.image is frame.image
    fist = signals.replace(left_hand_pose=named_hand("fist", "left"))
    hidden = render_frame(avatar, fist, back, settings, frame)
    assert hidden.counters["hand_distances"] == hidden.counters["pixels_shaded"] == 0
    assert hidden.image is frame.image


def test_what_only_seemed_hidden_is_drawn_after_all(avatar: Avatar, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("avatarrex.pipeline.hidden_behind", lambda bounds, *_: frozenset(bounds))
    frame = render_frame(avatar, STAND, FRONT, SETTINGS)
    assert set(frame.volume.parts) == set(PARTS)
    assert (frame.pointmap.part_weight > 0).any((0, 1)).all()
    monkeypatch.undo()
    torch.testing.assert_close(frame.image, render_frame(avatar, STAND, FRONT, SETTINGS).image, rtol=0, atol=0)


def test_a_ray_that_passes_a_cover_by_a_pixel_reaches_the_part(avatar: Avatar, posed: PosedPerson) -> None:
    """One pixel of the cover that is only partly covered is enough."""
    bounds = Bounds.of(avatar, posed, "face", SETTINGS.part_voxel)
    pointmap = raycast(build_volume(avatar, posed, SETTINGS, Counters(), None).sdf, FRONT, "torch")
    toward = FRONT.centre + 0.3 * (posed.root_from_part("face")[:3, 3] - FRONT.centre)
    wall = torch.as_tensor(toward, dtype=torch.float32).expand_as(pointmap.position)
    covering = replace(pointmap, position=wall, coverage=torch.ones_like(pointmap.coverage))
    assert bounds.covered(covering, FRONT)
    middle = bounds.seen_from(FRONT).mean(0) @ FRONT.intrinsics.T
    x, y = (middle[:2] / middle[2]).astype(int)
    coverage = covering.coverage.clone()
    coverage[y, x] = 0.99
    assert not bounds.covered(replace(covering, coverage=coverage), FRONT)


def test_a_hand_s_pose_off_screen_is_built_when_it_comes_into_view(avatar: Avatar, posed: PosedPerson) -> None:
    face = near(posed, "face")
    before = render_frame(avatar, STAND, FRONT, SETTINGS)
    fist = STAND.replace(left_hand_pose=named_hand("fist", "left"))
    away = render_frame(avatar, fist, face, SETTINGS, before)
    assert away.counters["hand_distances"] == 0
    back = render_frame(avatar, fist, FRONT, SETTINGS, away)
    assert back.counters["hand_distances"] > 0
    torch.testing.assert_close(back.image, render_frame(avatar, fist, FRONT, SETTINGS).image, rtol=0, atol=1e-6)
