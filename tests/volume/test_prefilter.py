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
from avatarrex.volume.bricks import ROW, Bricks
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


def bricks_of(grid: BodyGrid, side: int, known: np.ndarray | None = None) -> Bricks:
    """Every cell of `grid` as a brick of the limb, evaluated where the finer lattice is `known`."""
    shape = tuple(n - 1 for n in grid.sdf.shape)
    finer = body_grid(LIMB, (0, 0, 0), VOXEL / side, tuple(n * side + 1 for n in shape)).sdf.numpy()
    known = np.ones(finer.shape, dtype=bool) if known is None else known
    value, there = (
        np.lib.stride_tricks.sliding_window_view(one, (side + 1,) * 3)[::side, ::side, ::side].reshape(
            -1, *(side + 1,) * 3
        )
        for one in (finer, known)
    )
    # In any order: what lies beside is found by number.
    cell = np.random.default_rng(0).permutation(len(value))
    return Bricks.of(side, cell, value[cell], there[cell], grid.sdf.numpy())


def stored(bricks: Bricks, layers: int) -> np.ndarray:
    """Values of bricks in the atlas of a grid of so many layers."""
    n = bricks.side + 1
    tiled = bricks.atlas[layers:, : ROW * n, : ROW * n].numpy().reshape(-1, n, ROW, n, ROW, n)
    return tiled.transpose(0, 2, 4, 1, 3, 5).reshape(-1, n, n, n)[: len(bricks.cell)]


@pytest.mark.parametrize("side", [2, 4])
def test_bricks_are_the_finer_grid_prefiltered(side: int) -> None:
    """What a brick lacks for its outer corners is taken from those beside it, where there are any."""
    raw = grid_of(LIMB)
    now = prefiltered(replace(raw, bricks=bricks_of(raw, side)))
    whole = prefiltered(body_grid(LIMB, (0, 0, 0), VOXEL / side, (30 * side + 1,) * 3)).sdf.numpy()
    assert now.bricks is not None
    wanted = np.lib.stride_tricks.sliding_window_view(whole, (side + 1,) * 3)[::side, ::side, ::side]
    np.testing.assert_array_equal(stored(now.bricks, 31), wanted.reshape(-1, *(side + 1,) * 3)[now.bricks.cell])
    assert torch.equal(now.bricks.atlas[:31, :31, :31], now.sdf)
    assert torch.equal(prefiltered(now).bricks.atlas[31:], now.bricks.atlas[31:]), "its values stay the field's"


def test_corners_of_bricks_that_were_not_evaluated_are_not_looked_at() -> None:
    raw = grid_of(LIMB)
    known = np.ones((61, 61, 61), dtype=bool)
    known[30, 21, 25] = False
    all_known, one_less = (prefiltered(replace(raw, bricks=bricks_of(raw, 2, one))).bricks for one in (None, known))
    assert all_known is not None
    assert one_less is not None
    there = (
        np.stack(np.unravel_index(one_less.cell, (30, 30, 30)))[..., None, None, None] * 2
        + np.indices((3, 3, 3))[:, None]
    )
    off = np.array([30, 21, 25])[:, None, None, None, None]
    beside = np.abs(there - off).sum(0)
    np.testing.assert_array_equal(stored(one_less, 31)[beside == 0], one_less.value[beside == 0])
    changed = stored(one_less, 31) != stored(all_known, 31)
    assert changed[beside == 1].any()
    assert not changed[beside > 1].any()


def test_a_brick_alone_has_neighbours_within_alone() -> None:
    raw = grid_of(LIMB)
    whole = bricks_of(raw, 2)
    one = Bricks.of(2, whole.cell[:1], whole.value[:1], whole.known[:1], raw.sdf.numpy())
    now = prefiltered(replace(raw, bricks=one)).bricks
    assert now is not None
    value, found = one.value[0].astype(float), stored(now, 31)[0]
    change = sum((value.take(0, k) - 2 * value.take(1, k) + value.take(2, k))[(1, 1)] for k in range(3)) / 12
    assert found[1, 1, 1] == pytest.approx(value[1, 1, 1] - change, abs=1e-7)
    corners = np.ix_((0, 2), (0, 2), (0, 2))
    np.testing.assert_array_equal(found[corners], one.value[0][corners])


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar("default")


def test_levels_that_have_it(avatar: Avatar) -> None:
    signals, camera = Signals.rest().replace(body_pose=named_pose("stand")), Camera.orbit(20, width=24, height=24)
    frame = None
    for name, has in {"paper": False, "fast": True, "balanced": True, "fine": True, "quality": True}.items():
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


def test_bricks_that_were_stored_prefiltered_are_not_kept_by_a_level_without(avatar: Avatar) -> None:
    signals, camera = Signals.rest().replace(body_pose=named_pose("stand")), Camera.orbit(20, width=24, height=24)
    settings = replace(level("fine"), raycast="torch", antialias=False)
    before = render_deferred(avatar, signals, camera, settings)
    raw = render_deferred(avatar, signals, camera, replace(settings, prefilter=False), before).volume.sdf.body
    assert raw.bricks is not None
    np.testing.assert_array_equal(stored(raw.bricks, len(raw.sdf)), raw.bricks.value)
    had = before.volume.sdf.body.bricks
    assert had is not None
    assert (stored(had, len(raw.sdf)) != had.value).any()


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
