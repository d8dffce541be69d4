"""What is stored at voxels is such that interpolation between them is right on average."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.levels import level
from avatarrex.pipeline import render_deferred
from avatarrex.pointmap.raycast import raycast
from avatarrex.reference.solids import Solid, body_grid, capsule, sphere
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.volume.bricks import Bricks
from avatarrex.volume.build import build_volume, refine_volume
from avatarrex.volume.prefilter import LEAST, MOST, prefiltered
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume, sample

VOXEL = 0.02
LIMB = capsule((0.17, 0.1, 0.23), (0.43, 0.5, 0.37), 0.05)


def grid_of(field: Solid) -> BodyGrid:
    return body_grid(field, (0, 0, 0), VOXEL, (31, 31, 31))


def heights(grid: BodyGrid) -> np.ndarray:
    """Millimetres over the true limb where a view from each side meets the stored one."""
    found = []
    for azimuth in (0, 90, 180, 270):
        seen = raycast(
            SdfVolume(grid), Camera.orbit(azimuth, 10, 2, 20, (0.3, 0.3, 0.3), 64, 64), "torch", antialias=False
        )
        found.append(LIMB(seen.position[seen.hit].double()).numpy())
    return 1e3 * np.concatenate(found)


def test_a_limb_is_as_thick_as_it_is() -> None:
    raw = grid_of(LIMB)
    before, now = heights(raw), heights(prefiltered(raw))
    assert before.mean() == pytest.approx(-1e3 * VOXEL**2 / 12 / 0.05, rel=0.25)
    assert abs(now.mean()) < 0.1 * abs(before.mean())
    assert np.sqrt(np.square(now).mean()) < 0.6 * np.sqrt(np.square(before).mean())


def test_a_plane_stays() -> None:
    raw = grid_of(lambda p: p @ torch.tensor([0.48, 0.6, 0.64], dtype=p.dtype) - 0.5)
    torch.testing.assert_close(prefiltered(raw).sdf, raw.sdf, atol=1e-7, rtol=0)


def test_only_what_was_evaluated_is_looked_at() -> None:
    """A neighbour that is a guess says nothing along its axis; the other axes still do."""
    raw = grid_of(sphere((0.3, 0.3, 0.3), 0.17))
    known = np.ones(raw.sdf.shape, dtype=bool)
    known[15, 5, 16] = known[3, 3, 3] = False
    guessed = raw.sdf.clone()
    guessed[15, 5, 16] = 7.0
    one, whole = prefiltered(replace(raw, sdf=guessed, known=known)).sdf, prefiltered(raw).sdf
    along_x = (raw.sdf[15, 5, 16] - 2 * raw.sdf[15, 5, 15] + raw.sdf[15, 5, 14]) / 12
    torch.testing.assert_close(one[15, 5, 15], whole[15, 5, 15] + along_x)
    assert one[15, 5, 16] == 7
    assert one[3, 3, 3] == raw.sdf[3, 3, 3]
    assert one[10, 10, 10] == whole[10, 10, 10]


def test_signs_stay_and_creases_are_not_thrown_far() -> None:
    def crease(p: torch.Tensor) -> torch.Tensor:
        return 0.003 - (p[:, 0] - 0.3).abs()

    def touching(p: torch.Tensor) -> torch.Tensor:
        return (p - 0.3).norm(dim=-1) - 0.2 + 1e-4

    for field in (crease, touching):
        raw = grid_of(field)
        now = prefiltered(raw).sdf
        assert torch.equal(now < 0, raw.sdf < 0)
        assert (now - raw.sdf).abs().max() <= MOST * VOXEL + 1e-8
    assert (now.abs() <= LEAST * 1.01).any()  # the second has voxels whose sign would have changed


def test_bricks_stay_and_lie_in_the_new_grid() -> None:
    raw = grid_of(LIMB)
    number = 15 * 30 * 30 + 12 * 30 + 13
    bricks = Bricks.of(2, np.array([number]), np.full((1, 3, 3, 3), 0.5, np.float32), raw.sdf.numpy())
    now = prefiltered(replace(raw, bricks=bricks))
    assert now.bricks is not None
    assert torch.equal(now.bricks.atlas[:31, :31, :31], now.sdf)
    assert torch.equal(now.bricks.atlas[31:], bricks.atlas[31:])
    assert torch.equal(now.bricks.number, bricks.number)
    assert torch.equal(bricks.atlas[:31, :31, :31], raw.sdf)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar("default")


def test_levels_that_have_it(avatar: Avatar) -> None:
    signals, camera = Signals.rest().replace(body_pose=named_pose("stand")), Camera.orbit(20, width=24, height=24)
    frame = None
    for name, has in {"paper": False, "fast": True, "balanced": True, "fine": False, "quality": False}.items():
        frame = render_deferred(avatar, signals, camera, replace(level(name), raycast="torch", antialias=False), frame)
        volume = frame.volume
        wanted = prefiltered(volume.grid).sdf if has else volume.grid.sdf
        assert torch.equal(volume.sdf.body.sdf, wanted), name
        assert torch.equal(prefiltered(volume.grid).sdf, volume.grid.sdf) is False


def test_bricks_that_are_kept_lie_in_the_grid_of_their_level(avatar: Avatar) -> None:
    """From `balanced` to `fine` and back, of a view that meets no cell but those that have bricks."""
    signals, camera = Signals.rest().replace(body_pose=named_pose("stand")), Camera.orbit(20, width=24, height=24)
    settings = replace(level("balanced"), raycast="torch", antialias=False)
    before = render_deferred(avatar, signals, camera, settings)
    fine = build_volume(avatar, before.posed, replace(level("fine"), raycast="torch"), Counters(), before.volume)
    bare = refine_volume(fine, np.zeros(0, np.int64), 2, Counters(), before.volume)
    back = build_volume(avatar, before.posed, settings, Counters(), bare)
    for volume in (before.volume, bare, back):
        body = volume.sdf.body
        assert body.bricks is not None
        assert (body.bricks.number > 0).any()
        z, y, x = body.sdf.shape
        assert torch.equal(body.bricks.atlas[:z, :y, :x], body.sdf)


@pytest.mark.parametrize("name", ["fast", "balanced"])
def test_nothing_jumps_at_the_faces_of_a_box_in_contact(avatar: Avatar, name: str) -> None:
    signals, camera = (
        Signals.rest().replace(body_pose=named_pose("hands_on_hips")),
        Camera.orbit(20, width=24, height=24),
    )
    volume = render_deferred(avatar, signals, camera, replace(level(name), raycast="torch", antialias=False)).volume
    (box,) = (part for part in volume.sdf.parts if part.name == "left_hand")
    assert box.contact
    rng, out = np.random.default_rng(0), np.linalg.inv(box.box_from_root)
    jumps = []
    for axis in range(3):
        for end, step in ((0.0, -1e-5), (float(box.size[axis]), 1e-5)):
            place = rng.uniform(0, 1, (4000, 3)) * box.size
            place[:, axis] = end
            aside = np.zeros(3)
            aside[axis] = step
            sides = (torch.from_numpy((place + k * aside) @ out[:3, :3].T + out[:3, 3]) for k in (-1, 1))
            inner, outer = (sample(volume.sdf, one).composed.sdf for one in sides)
            jumps.append((inner - outer)[outer.abs() < 0.005])
    assert len(torch.cat(jumps)) > 100
    assert torch.cat(jumps).abs().median() < 5e-5


def test_a_frame_is_nearer_to_the_fine_one(avatar: Avatar) -> None:
    """Depth against level `quality`, and how much of the picture is covered."""
    signals, camera = (
        Signals.rest().replace(body_pose=named_pose("run")),
        Camera.orbit(10, 5, 2.6, 40, (0, 0, 0), 128, 128),
    )
    fine = render_deferred(avatar, signals, camera, level("quality")).pointmap
    bare = fine.part_weight.sum(-1) < 0.5
    found = {}
    for has in (False, True):
        seen = render_deferred(avatar, signals, camera, RenderSettings(prefilter=has)).pointmap
        both = fine.hit & seen.hit & bare
        depth, area = (seen.depth - fine.depth)[both], float(seen.coverage.sum() / fine.coverage.sum())
        found[has] = float(depth.abs().mean()), float(depth.median()), area - 1
    assert found[True][0] < 0.87 * found[False][0]
    assert abs(found[True][1]) < 0.25 * abs(found[False][1])
    assert abs(found[True][2]) < 0.3 * abs(found[False][2])


def test_switching_it_evaluates_nothing(avatar: Avatar) -> None:
    settings = RenderSettings(raycast="torch", antialias=False, part_voxel=0.01)
    signals, camera = Signals.rest().replace(body_pose=named_pose("stand")), Camera.orbit(20, width=24, height=24)
    first = render_deferred(avatar, signals, camera, settings)
    counters = Counters()
    raw = build_volume(avatar, first.posed, replace(settings, prefilter=False, thin=0), counters, first.volume)
    assert torch.equal(raw.sdf.body.sdf, first.volume.grid.sdf)
    assert counters["voxels_evaluated"] == 0
