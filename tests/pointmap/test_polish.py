"""Polished hits: nearer to the exact field, never far from where they were, and no work when nothing changed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pointmap.dense_solid import DenseSolid

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.fields.composition import Composed
from avatarrex.frame import Frame
from avatarrex.pipeline import render_frame
from avatarrex.pointmap.polish import CONVERGED, FLATTEST, descend, descend_reference, reach
from avatarrex.reference.oracle import exact_field
from avatarrex.reference.solids import sphere
from avatarrex.reference.voxel_frame import pose_reference
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import Turn, named_hand, named_pose, turned
from avatarrex.volume.composed_field import ComposedField

SETTINGS = RenderSettings(raycast="torch", part_voxel=0.005, antialias=True)
SIGNALS = Signals.rest().replace(body_pose=named_pose("walk"))
CAMERA = Camera.orbit(20, 5, 2.6, 40, (0, -0.05, 0), 48, 48)
PRESSED: dict[str, Turn] = {
    "both_collar": (9, 13.3, -10.3),
    "both_shoulder": (28.6, 16.2, -55.1),
    "both_elbow": (-12.3, -97.9, -8.1),
    "both_wrist": (-2.9, 5.9, -28.2),
}
"""Hands on the hips, finger tips in the cloth."""
BALL = DenseSolid(sphere((0, 0, 0), 0.3))


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


@pytest.fixture(scope="module")
def rough(avatar: Avatar) -> Frame:
    return render_frame(avatar, SIGNALS, CAMERA, SETTINGS)


@pytest.fixture(scope="module")
def polished(avatar: Avatar, rough: Frame) -> Frame:
    return render_frame(avatar, SIGNALS, CAMERA, replace(SETTINGS, polish=2), rough)


@pytest.fixture(scope="module")
def exact(avatar: Avatar) -> ComposedField:
    return exact_field(avatar, pose_reference(avatar, SIGNALS), frozenset())


def off_the_ball() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points within 5 mm of a ball's surface, seen from +Z; and the slope along z there, roughly."""
    noise = torch.Generator().manual_seed(3)
    x, y, off = 0.4 * torch.rand(3, 200, generator=noise, dtype=torch.float64) - 0.2
    z = (0.09 - x * x - y * y).sqrt()
    direction = torch.tensor([0, 0, -1.0]).double().expand(200, 3)
    return torch.stack([x, y, z + 0.025 * off], 1), direction, -z / 0.3


def test_a_ball_is_reached_along_the_ray() -> None:
    start, direction, along = off_the_ball()
    bound = torch.full((200,), 0.01).double()
    moved, _ = descend(BALL, start, direction, along, bound, 2)
    surface = start + moved[:, None] * direction
    assert BALL.sdf(start).abs().median() > 1e-3
    assert BALL.sdf(surface).abs().max() < 1e-6
    nearest = descend_reference(BALL, start, direction, bound)
    torch.testing.assert_close(moved, nearest, rtol=0, atol=2e-6)


def test_no_step_leaves_the_bound_and_none_that_makes_it_worse_is_taken() -> None:
    start, direction, along = off_the_ball()
    bound = torch.full((200,), 0.001).double()
    moved, _ = descend(BALL, start, direction, along, bound, 2)
    assert (moved.abs() <= bound).all()
    assert (moved.abs() == bound).sum() > 50
    assert (BALL.sdf(start + moved[:, None] * direction).abs() <= BALL.sdf(start).abs()).all()

    queried: list[int] = []

    def jumps(position: torch.Tensor) -> Composed:
        """The ball where it is queried first, 4 cm away from anything later."""
        queried.append(len(position))
        return replace(BALL(position), sdf=BALL.sdf(position) if len(queried) == 1 else 0.04 + 0 * position[:, 0])

    stayed, _ = descend(jumps, start, direction, along, 20 * bound, 2)
    assert len(queried) == 3
    assert (stayed[BALL.sdf(start).abs() > CONVERGED] == 0).all()


def test_a_grazing_slope_throws_nobody_away() -> None:
    start, direction, _ = off_the_ball()
    moved, _ = descend(BALL, start, direction, torch.zeros(200).double(), torch.ones(200).double(), 0)
    assert (moved.abs() <= CONVERGED / -FLATTEST).all()


def test_hits_come_nearer_to_the_exact_field(rough: Frame, polished: Frame, exact: ComposedField) -> None:
    hit = rough.pointmap.hit
    before, after = (exact.sdf(frame.pointmap.position[hit].double()).abs() for frame in (rough, polished))
    assert before.median() > 1e-4
    assert after.median() < 0.02 * before.median()
    assert after.mean() < 0.2 * before.mean()
    assert (after <= before + 2e-4).all()


def test_polish_moves_hits_along_their_rays_by_a_voxel_at_most(rough: Frame, polished: Frame) -> None:
    covered = rough.pointmap.coverage > 0
    move = (polished.pointmap.position - rough.pointmap.position)[covered]
    bound = reach(rough.volume.sdf, rough.pointmap.part_weight[covered])
    assert (move.norm(dim=-1) <= bound + 1e-6).all()
    centre = torch.as_tensor(CAMERA.seen_from(rough.world_from_root).centre).float()
    ray = rough.pointmap.position[covered] - centre
    assert torch.cross(ray / ray.norm(dim=-1, keepdim=True), move, dim=-1).norm(dim=-1).max() < 1e-6
    for field in ("position", "depth", "part_weight"):
        assert torch.isfinite(getattr(polished.pointmap, field)).all()
    assert torch.isfinite(polished.image).all()
    assert torch.equal(polished.pointmap.coverage, rough.pointmap.coverage)


def test_depth_is_the_polished_positions_own(polished: Frame) -> None:
    row = CAMERA.seen_from(polished.world_from_root).camera_from_world[2]
    covered = polished.pointmap.coverage > 0
    depth = polished.pointmap.position[covered].double().numpy() @ row[:3] + row[3]
    np.testing.assert_allclose(polished.pointmap.depth[covered].numpy(), depth, rtol=0, atol=1e-6)


def test_most_hits_land_on_the_root_of_the_reference(rough: Frame, polished: Frame, exact: ComposedField) -> None:
    some = torch.nonzero(rough.pointmap.hit.flatten())[::5, 0]
    start = rough.pointmap.position.view(-1, 3)[some].double()
    end = polished.pointmap.position.view(-1, 3)[some].double()
    centre = torch.as_tensor(CAMERA.seen_from(rough.world_from_root).centre)
    direction = torch.nn.functional.normalize(start - centre, dim=-1)
    root = descend_reference(exact, start, direction, torch.full((len(some),), 0.005).double())
    found = root.isfinite()
    assert found.float().mean() > 0.9
    off = (((end - start) * direction).sum(-1) - root)[found].abs()
    assert off.median() < 2e-6
    assert off.quantile(0.9) < 1e-4


def test_a_polished_point_has_the_colour_of_the_limb_it_came_to(avatar: Avatar) -> None:
    """A finger tip that the cloth of the exact field covers, and that of voxels of 2 cm does not, was grey."""
    signals = Signals.rest().replace(
        body_pose=turned(np.zeros((21, 3)), PRESSED), left_hand_pose=named_hand("relaxed", "left")
    )
    view = Camera.orbit(40, 0, 0.2, 30, (0.11, 0.07, 0.1), 64, 64)
    settings = replace(SETTINGS, part_voxel=0.0025, antialias=False, hidden=frozenset({"right_hand", "face"}))
    rough = render_frame(avatar, signals, view, settings)
    polished = render_frame(avatar, signals, view, replace(settings, polish=1), rough)
    assert rough.pointmap.side is None
    assert polished.pointmap.side is not None
    covered = polished.pointmap.coverage > 0
    buried = covered & (rough.pointmap.part_weight.sum(-1) == 1) & (polished.pointmap.part_weight.sum(-1) == 0)
    assert 5 < buried.sum() < 100
    assert (polished.pointmap.side[buried] == 1).all(), "others than the left hand's own"
    red, _, blue = polished.image[buried][:, :3].unbind(-1)
    assert (blue > red + 0.05).float().mean() > 0.9, "of the dark blue stripe around, as the oracle has it"


def test_nothing_is_polished_again(avatar: Avatar, polished: Frame) -> None:
    assert polished.counters["hits_polished"] == int((polished.pointmap.coverage > 0).sum())
    assert polished.counters["voxels_evaluated"] == 0
    again = render_frame(avatar, SIGNALS, CAMERA, replace(SETTINGS, polish=2), polished)
    assert again.pointmap is polished.pointmap
    assert not any(again.counters.values())
    plain = render_frame(avatar, SIGNALS, CAMERA, SETTINGS, polished)
    assert plain.counters["hits_polished"] == 0
    assert plain.counters["rays"] > 0


def test_hidden_parts_are_not_queried(avatar: Avatar) -> None:
    hidden = frozenset({"left_hand", "right_hand", "face"})
    frame = render_frame(avatar, SIGNALS, CAMERA, replace(SETTINGS, polish=1, hidden=hidden))
    assert frame.counters["hits_polished"] > 0
    assert frame.counters["hand_distances"] == frame.counters["face_evaluations"] == frame.counters["unet_runs"] == 0
