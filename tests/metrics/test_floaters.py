"""What floats is found where it was put, and nothing where all hangs together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.metrics import floaters
from avatarrex.metrics.floaters import directions, find_floaters, islands, lumps
from avatarrex.reference.solids import body_grid, capsule, capsule_man, sphere, union
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.volume.sdf_volume import SdfVolume

BALL = sphere((0, 0, 0), 0.3)
AWAY = (0.0, 0.5, 0.1)
JOINTS = np.zeros((len(JOINT_NAMES), 3))
JOINTS[JOINT_NAMES.index("head")] = AWAY


def volume(*solids):
    """The union of solids on 2 cm voxels."""
    return SdfVolume(body_grid(union(*solids), (-0.5, -0.5, -0.5), 0.02, (51, 62, 51)))


def test_26_directions():
    found = directions()
    assert found.shape == (26, 3)
    assert len(np.unique(found, axis=0)) == 26
    assert np.array_equal(found[0], [0, 0, 1])
    assert np.abs(found.sum(0)).max() == 0
    assert floaters._words(np.array([1.0, -1.0, 1.0])) == "front left below"


def test_one_piece_has_none():
    """A ball; a ball with a stalk; the capsule man, whose hands and face are boxes of their own."""
    for solid in (volume(BALL), volume(BALL, capsule((0, 0.2, 0), (0, 0.6, 0), 0.03)), capsule_man()):
        assert islands(solid, JOINTS, 64) == ()
        assert lumps(solid, JOINTS) == ()


def test_a_ball_apart_is_found_at_its_size_and_place():
    (lump,) = lumps(volume(BALL, sphere(AWAY, 0.05)), JOINTS)
    assert lump.size_mm == pytest.approx(100, abs=10)
    assert lump.volume_mm3 == pytest.approx(4 / 3 * np.pi * 50**3, rel=0.1), "linear between voxels, a ball is smaller"
    assert lump.place == pytest.approx(AWAY, abs=0.002)
    assert lump.near == "head"


def test_a_ball_apart_is_an_island_where_it_stands_off_the_silhouette():
    found = islands(volume(BALL, sphere(AWAY, 0.05)), JOINTS, 96)
    seen = {island.view for island in found}
    assert {"front", "back", "left", "right"} <= seen
    assert not seen & {"above", "below"}, "there the large ball hides it, or lies beyond it"
    assert len(found) == len(seen)
    front = next(island for island in found if island.view == "front")
    assert front.near == "head"
    assert front.place == pytest.approx((0, 0.5, 0.14), abs=0.03), "the side that faces the camera"
    assert front.pixels == max(island.pixels for island in found if island.view in ("front", "back"))
    assert [island.pixels for island in found] == sorted((island.pixels for island in found), reverse=True)


def test_what_no_silhouette_shows_is_a_lump():
    """A ball in the cavity of a shell."""
    shell = lambda p: torch.maximum(BALL(p), -sphere((0, 0, 0), 0.22)(p))  # noqa: E731
    hollow = volume(shell, sphere((0, 0, 0), 0.06))
    assert islands(hollow, JOINTS, 64) == ()
    (lump,) = lumps(hollow, JOINTS)
    assert lump.place == pytest.approx((0, 0, 0), abs=1e-3)


def test_one_negative_voxel_is_a_lump_of_millimetres():
    """Trilinear values: −1 mm at the voxel, +19 mm around it, so negative within a twentieth of a voxel alone."""
    grid = volume(BALL).body
    sdf = grid.sdf.clone()
    sdf[25, 58, 25] = -0.001
    (lump,) = lumps(SdfVolume(replace(grid, sdf=sdf)), JOINTS)
    assert lump.size_mm == 5
    assert lump.place == pytest.approx((0, 0.66, 0), abs=1e-6)


def test_specks_are_not_islands(monkeypatch):
    apart = volume(BALL, sphere(AWAY, 0.05))
    largest = islands(apart, JOINTS, 64)[0].pixels
    monkeypatch.setattr(floaters, "SPECKS", largest)
    assert islands(apart, JOINTS, 64) == ()


def test_a_patched_grid_of_the_packaged_avatar_is_reported(monkeypatch):
    """A block of 10 cm below an arm; without it, what the packaged avatar has is a list of small things."""
    from avatarrex.avatar_file import load_avatar
    from avatarrex.signals.driving import Signals

    poses = {"rest": Signals.rest()}
    avatar = load_avatar()
    (plain,) = find_floaters(avatar, poses, 192)
    assert plain.views == 26
    assert all(np.isfinite(lump.place).all() and 0 < lump.size_mm < 60 for lump in plain.lumps)
    built, place = floaters.build_volume, []

    def patched(*arguments):
        made = built(*arguments)
        grid = made.sdf.body
        sdf = grid.sdf.clone()
        middle = np.array(sdf.shape) // 2
        z, y, x = middle[0], middle[1], middle[2] + 20
        while (sdf[z - 3 : z + 4, y - 3 : y + 4, x - 3 : x + 4] <= 0.02).any():
            y -= 1
        sdf[z - 2 : z + 3, y - 2 : y + 3, x - 2 : x + 3] = -0.01
        place.append(grid.origin + grid.voxel * np.array([x, y, z]))
        return replace(made, sdf=replace(made.sdf, body=replace(grid, sdf=sdf, bricks=None)))

    monkeypatch.setattr(floaters, "build_volume", patched)
    (found,) = find_floaters(avatar, poses, 192)
    assert len(found.lumps) == len(plain.lumps) + 1
    assert found.lumps[0].place == pytest.approx(place[0], abs=0.005)
    assert found.lumps[0].size_mm == pytest.approx(90, abs=15)
    assert len(found.islands) > len(plain.islands)
    assert "lump" in found.line()
    assert found.line().startswith("rest: ")
