"""Thin limbs: bricks on forearms and wrists, whatever a view meets. Uses the packaged avatar."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.counters import Counters
from avatarrex.levels import LEVELS
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.templates.parts import HANDS
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume import thin_limbs
from avatarrex.volume.build import AvatarVolume, build_volume
from avatarrex.volume.narrow_band import crossed
from avatarrex.volume.sdf_volume import distance

SETTINGS = RenderSettings(prefilter=False, hidden=frozenset((*HANDS, "face")))


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


@pytest.fixture(scope="module")
def posed(avatar: Avatar) -> PosedPerson:
    return pose_person(avatar.person, Signals.rest().replace(body_pose=named_pose("wave")), Counters(), None)


@pytest.fixture(scope="module")
def volume(avatar: Avatar, posed: PosedPerson) -> AvatarVolume:
    return build_volume(avatar, posed, SETTINGS, Counters(), None)


def centres(volume: AvatarVolume, cell: np.ndarray) -> np.ndarray:
    """Of cells (c, 3: z, y, x), root frame."""
    return np.asarray(volume.grid.origin + volume.grid.voxel * (cell[:, ::-1] + 0.5))


def cells_with_bricks(volume: AvatarVolume) -> np.ndarray:
    """(c, 3)."""
    assert volume.stored.bricks is not None
    return np.stack(np.unravel_index(volume.stored.bricks.cell, volume.stored.bricks.number.shape), -1)


def test_thin_vertices_are_those_from_elbow_to_wrist_on_both_sides(avatar: Avatar) -> None:
    posed = pose_person(avatar.person, Signals.rest(), Counters(), None).body
    across = posed.vertices.numpy()[avatar.person.thin_limbs, 0]
    for name, side in (("left", 1), ("right", -1)):
        elbow, finger = (
            side * float(posed.joints[JOINT_NAMES.index(f"{name}_{joint}"), 0]) for joint in ("elbow", "index1")
        )
        own = side * across[side * across > 0]
        assert elbow - 0.06 < own.min() < elbow
        assert finger - 0.05 < own.max() < finger + 0.05


def test_every_cell_that_holds_their_surface_is_a_brick_and_few_others_are(
    avatar: Avatar, volume: AvatarVolume
) -> None:
    cell = crossed(volume.grid.sdf.numpy() < 0)
    thin = avatar.person.thin_limbs[closest_vertex(volume.skin.closest, centres(volume, cell))[1]]
    assert volume.stored.bricks is not None
    number = volume.stored.bricks.number.numpy()
    assert (number[tuple(cell[thin].T)] > 0).all()
    assert (number > 0).sum() < 1.2 * thin.sum() < 0.1 * len(cell)


def test_forearms_are_nearer_to_the_field_and_the_rest_is_as_it_was(
    avatar: Avatar, posed: PosedPerson, volume: AvatarVolume
) -> None:
    plain = build_volume(avatar, posed, replace(SETTINGS, thin=0), Counters(), None)
    assert plain.stored is plain.sdf.body is plain.grid
    assert torch.equal(plain.grid.sdf, volume.grid.sdf)
    shift = np.random.default_rng(0).uniform(-0.5, 0.5, (4, 1, 3)) * volume.grid.voxel
    points = torch.from_numpy((centres(volume, cells_with_bricks(volume)) + shift).reshape(-1, 3)).float()
    with torch.no_grad():
        exact = volume.body.sdf(points, Counters())
    near = exact.abs() < 0.003
    coarse, fine = ((distance(v.sdf, points) - exact).abs()[near].mean() for v in (plain, volume))
    assert fine < 0.35 * coarse
    assert coarse > 0.0009
    elsewhere = torch.from_numpy(
        posed.body.vertices.numpy()[~avatar.person.thin_limbs & (avatar.person.hand_weight.numpy() == 0)]
    )
    same = distance(plain.sdf, elsewhere) == distance(volume.sdf, elsewhere)
    assert same.float().mean() > 0.97


def test_what_the_grid_evaluated_is_not_evaluated_again(avatar: Avatar, volume: AvatarVolume) -> None:
    side, counters, all_counters = 2, Counters(), Counters()
    found = thin_limbs.with_thin_limbs(volume.body, volume.grid, avatar.person.thin_limbs, side, counters).bricks
    forgetful = replace(volume.grid, known=None)
    anew = thin_limbs.with_thin_limbs(volume.body, forgetful, avatar.person.thin_limbs, side, all_counters).bricks
    assert found is not None
    assert anew is not None
    assert np.array_equal(found.cell, anew.cell)
    np.testing.assert_allclose(found.value, anew.value, rtol=0, atol=1e-6)
    assert 0.7 < counters["voxels_evaluated"] / all_counters["voxels_evaluated"] < 0.9


def test_nothing_is_thin_where_no_surface_is(avatar: Avatar, volume: AvatarVolume) -> None:
    none = np.zeros_like(avatar.person.thin_limbs)
    assert thin_limbs.with_thin_limbs(volume.body, volume.grid, none, 2, Counters()) is volume.grid


def test_they_are_kept_while_the_pose_holds_whatever_the_level_was(
    avatar: Avatar, posed: PosedPerson, volume: AvatarVolume
) -> None:
    counters = Counters()
    bare = build_volume(avatar, posed, replace(SETTINGS, bricks=2), counters, volume)
    assert bare.grid is volume.grid
    assert bare.stored is bare.sdf.body is bare.grid
    assert not any(counters.as_dict().values())
    again = build_volume(avatar, posed, SETTINGS, counters, bare)
    assert again.stored.bricks is not None
    assert volume.stored.bricks is not None
    assert np.array_equal(again.stored.bricks.value, volume.stored.bricks.value)
    assert counters["voxels_evaluated"] > 0
    other = build_volume(avatar, posed, replace(SETTINGS, hidden=frozenset(HANDS)), Counters(), again)
    assert other.sdf.body is again.stored


def test_only_the_level_of_everyday_has_them() -> None:
    having = {name for name, chosen in LEVELS.items() if chosen.thin and not chosen.bricks and not chosen.surface}
    assert having == {"balanced"}
