"""The exact frame: voxel frames converge to it, four times the samples change nothing, and the report says what it should."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.frame import Frame
from avatarrex.pipeline import render_frame
from avatarrex.pointmap.point_map import PointMap
from avatarrex.reference.error_report import Accuracy, depth_report, pixel_errors
from avatarrex.reference.oracle import STEP, Oracle, cast, near_seam, render_oracle
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_pose

SIGNALS = Signals.rest().replace(
    body_pose=named_pose("walk"),
    expression=named_expression("laugh"),
    global_orient=np.array([0.1, 0.5, 0.0]),
    translation=np.array([3.0, 0.2, -1.0]),
)
CAMERA = Camera.orbit(20, 5, 2.6, 40, (3.0, 0.15, -1.0), 32, 32)
FINE = RenderSettings(raycast="torch", antialias=False)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


@pytest.fixture(scope="module")
def oracle(avatar: Avatar) -> Oracle:
    return render_oracle(avatar, SIGNALS, CAMERA)


@pytest.fixture(scope="module")
def fine(avatar: Avatar) -> Frame:
    return render_frame(avatar, SIGNALS, CAMERA, FINE)


def test_its_points_are_on_the_field(oracle: Oracle) -> None:
    hit = oracle.pointmap.hit
    assert 100 < hit.sum() < 400
    on = oracle.field.sdf(oracle.pointmap.position[hit].double()).abs()
    assert on.median() < 1e-7
    assert torch.isfinite(oracle.image).all()
    length = oracle.pointmap.normal[hit].norm(dim=-1)
    torch.testing.assert_close(length, torch.ones_like(length))


def test_four_times_the_samples_find_the_same_surface(oracle: Oracle) -> None:
    finer = cast(oracle.field, oracle.camera, STEP / 4)
    assert torch.equal(finer.hit, oracle.pointmap.hit)
    assert (finer.depth - oracle.pointmap.depth).abs().max() < 1e-6


def test_smaller_voxels_come_nearer(avatar: Avatar, oracle: Oracle, fine: Frame) -> None:
    coarse = render_frame(avatar, SIGNALS, CAMERA, replace(FINE, voxel=0.04, part_voxel=0.01))
    errors = [depth_report(frame, oracle) for frame in (coarse, fine)]
    assert errors[1].pixels > 100
    assert errors[1].depth_median_mm < errors[0].depth_median_mm / 2
    assert errors[1].depth_median_mm < 1.0
    assert errors[1].flips < 0.05


def test_polish_comes_nearer_still(avatar: Avatar, oracle: Oracle, fine: Frame) -> None:
    polished = render_frame(avatar, SIGNALS, CAMERA, replace(FINE, polish=2), fine)
    before, after = depth_report(fine, oracle), depth_report(polished, oracle)
    assert after.depth_median_mm < before.depth_median_mm / 20
    assert after.depth_mean_mm < before.depth_mean_mm
    assert after.flips == before.flips
    same = (polished.pointmap.depth - oracle.pointmap.depth).abs() < 1e-4
    same &= polished.pointmap.hit & oracle.pointmap.hit
    error = (polished.image.double() - oracle.image)[same].square().mean()
    assert -10 * torch.log10(error) > 40


@pytest.mark.slow
def test_a_hand_of_smaller_voxels_comes_nearer(avatar: Avatar, fine: Frame) -> None:
    root = SIGNALS.replace(global_orient=np.zeros(3), translation=np.zeros(3))
    wrist = fine.posed.root_from_part("left_hand")
    camera = Camera.orbit(80, 5, 0.5, 24, wrist[:3, :3] @ np.array([0.09, 0, 0]) + wrist[:3, 3], 20, 20)
    exact = render_oracle(avatar, root, camera).pointmap
    errors = []
    for part_voxel in (0.01, 0.0025):
        seen = render_frame(avatar, root, camera, replace(FINE, part_voxel=part_voxel), fine).pointmap
        fingers = exact.hit & seen.hit & (exact.part_weight[..., 0] == 1)
        assert fingers.sum() > 30
        errors.append((seen.depth - exact.depth)[fingers].abs().median())
    assert errors[1] < errors[0] / 10  # twice halved; a chord's error goes with the square: 16
    assert errors[1] < 2e-4


def test_hidden_parts_are_not_there(avatar: Avatar) -> None:
    hidden = frozenset({"left_hand", "right_hand", "face"})
    bare = render_oracle(avatar, SIGNALS, Camera.orbit(20, 5, 2.6, 40, (3.0, 0.15, -1.0), 16, 16), hidden=hidden)
    assert bare.pointmap.hit.sum() > 10
    assert bare.pointmap.part_weight.abs().sum() == 0


def seen_as(frame: Frame, pointmap: PointMap, image: torch.Tensor) -> Frame:
    """`frame` with another point map and picture."""
    surface = replace(frame.surface, pointmap=pointmap)
    return replace(frame, surface=surface, shading=replace(frame.shading, image=image, unmixed=image))


def test_the_report_measures_what_was_done_to_a_frame(oracle: Oracle, fine: Frame) -> None:
    seen, image = oracle.pointmap, oracle.image.float().clone()
    same = seen_as(fine, seen, image)
    perfect = depth_report(same, oracle)
    assert perfect.depth_max_mm == perfect.flips == 0
    assert perfect.normal_mean_deg < 0.05
    assert perfect.colour_psnr_db > 120
    depth, hit = seen.depth + 0.002 * seen.hit, seen.hit.clone()
    first = tuple(torch.nonzero(hit)[0])
    hit[first] = False
    image[..., :3] += 0.1 * seen.hit[..., None]
    turned = seen.normal.clone()
    turned[seen.hit] = -turned[seen.hit]
    wrong = seen_as(fine, replace(seen, depth=depth, hit=hit, normal=turned), image)
    report = depth_report(wrong, oracle)
    count = int(seen.hit.sum())
    assert report.pixels == count - 1
    assert report.depth_mean_mm == pytest.approx(2, abs=1e-3)
    assert report.depth_p99_mm == pytest.approx(2, abs=1e-3)
    assert report.normal_mean_deg == pytest.approx(180, abs=0.1)
    assert report.flips == pytest.approx(1 / count)
    assert report.colour_psnr_db == pytest.approx(20, abs=0.01)
    pooled = Accuracy.of([pixel_errors(same, oracle), pixel_errors(wrong, oracle)])
    assert pooled.pixels == 2 * count - 1
    assert pooled.depth_mean_mm == pytest.approx(2 * (count - 1) / pooled.pixels, abs=1e-3)
    nothing = depth_report(same, oracle, torch.zeros_like(hit))
    assert nothing.pixels == 0
    assert math.isnan(nothing.depth_mean_mm)


def test_seams_are_where_parts_and_body_meet(avatar: Avatar, oracle: Oracle) -> None:
    weight = avatar.person.blend_weight
    neck = near_seam(oracle, weight[:, 2])
    assert 0 < neck.sum() < 0.3 * oracle.pointmap.hit.sum()
    share = oracle.pointmap.part_weight[..., 2]
    assert neck[(share > 0.05) & (share < 0.95)].all()
    assert not near_seam(oracle, torch.ones(len(weight)).scatter(0, torch.tensor([0]), 0.5))[neck].all()
