"""The composed field without voxels against what the volume builder stores, and what it promises to be empty."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pipeline import render_frame
from avatarrex.reference.oracle import exact_field
from avatarrex.reference.solids import lattice_points
from avatarrex.reference.voxel_frame import pose_reference
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_hand, named_pose
from avatarrex.templates.posed import pose_person
from avatarrex.volume.build import AvatarVolume, body_frame, build_volume
from avatarrex.volume.composed_field import ComposedField, PlacedPart, composed_field
from avatarrex.volume.sdf_volume import sample

HIP = Signals.rest().replace(body_pose=named_pose("hands_on_hips"))
SETTINGS = RenderSettings(prefilter=False, part_voxel=0.01)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar()


@pytest.fixture(scope="module")
def built(avatar: Avatar) -> tuple[AvatarVolume, ComposedField]:
    posed = pose_person(avatar.person, HIP, Counters(), None)
    volume = build_volume(avatar, posed, SETTINGS, Counters(), None)
    return volume, composed_field(avatar, posed, volume.body, volume.states, Counters())


@pytest.fixture(scope="module")
def exact(avatar: Avatar) -> ComposedField:
    return exact_field(avatar, pose_reference(avatar, HIP), frozenset())


def near_surface(built: tuple[AvatarVolume, ComposedField], count: int = 3000) -> torch.Tensor:
    """Body voxels within a voxel of the surface, float32."""
    grid = built[0].grid
    points = lattice_points(tuple(grid.sdf.shape), grid.voxel) + torch.as_tensor(grid.origin)
    near = torch.nonzero(grid.sdf.flatten().abs() < grid.voxel)[:, 0]
    chosen = near[torch.randperm(len(near), generator=torch.Generator().manual_seed(1))[:count]]
    return points[chosen].float()


def test_voxels_store_the_field(built: tuple[AvatarVolume, ComposedField]) -> None:
    volume, field = built
    points = near_surface(built)
    outside = torch.stack([part.apart(part.local(points)) > 0.05 for part in field.parts]).all(0)
    assert outside.sum() > 500
    stored = sample(volume.sdf, points[outside]).composed.sdf
    torch.testing.assert_close(field.sdf(points[outside]), stored, rtol=0, atol=1e-5)


def test_hands_on_hips_are_split_as_the_volume_does(built: tuple[AvatarVolume, ComposedField]) -> None:
    volume, field = built
    assert {part.name for part in volume.sdf.parts if part.contact is not None} == set(field.limbs) != set()
    points = near_surface(built)
    hands = [part for part in field.parts if part.name != "face"]
    inside = torch.stack([part.apart(part.local(points)) == 0 for part in hands]).any(0)
    stored, here = sample(volume.sdf, points[inside]).composed.sdf, field.sdf(points[inside])
    apart = (stored - here).abs()
    assert inside.sum() > 100
    assert apart.median() < 5e-4
    nobody = {name: replace(own, other_vertex=own.other_vertex & False) for name, own in field.body.contact.items()}
    without = replace(field, body=replace(field.body, contact=nobody))
    carved = (without.sdf(points[inside]) - here).abs()
    assert carved.max() > 0.003


@pytest.mark.parametrize(("pose", "name"), [("hands_on_hips", "left_hand"), ("think", "right_hand")])
def test_nothing_jumps_at_the_faces_of_a_hands_box(avatar: Avatar, pose: str, name: str) -> None:
    """Cloth beneath a fist, a cheek beside one: inside the box the limbs are split, outside the whole body is one field."""
    field = of_a_fist(avatar, pose)
    hand = next(part for part in field.parts if part.name == name)
    noise = torch.Generator().manual_seed(4)
    low, high = torch.as_tensor(hand.low), torch.as_tensor(hand.high)
    local = low + (high - low) * torch.rand(30000, 3, generator=noise, dtype=torch.float64)
    face, out = torch.arange(len(local)) % 3, 1e-6 * (torch.arange(len(local)) % 2 * 2 - 1)
    local[range(len(local)), face] = torch.where(out > 0, high[face], low[face])
    step = out[:, None] * torch.eye(3, dtype=torch.float64)[face]
    within, beyond = (from_part(hand, local + side * step) for side in (-1, 1))
    near = (
        (field.sdf(within).abs() < 0.01) & (hand.apart(hand.local(within)) == 0) & (hand.apart(hand.local(beyond)) > 0)
    )
    assert near.sum() > 300
    jump = (field.sdf(within[near]) - field.sdf(beyond[near])).abs()
    assert jump.quantile(0.98) < 1e-5
    assert jump.max() < 5e-4  # single precision: 1e-6 m is a few of its steps, and ω of the nearest vertices changes


def test_the_templates_fingers_carve_no_cloth(avatar: Avatar) -> None:
    """The template's hand is flat where the hand is a fist: its fingers lie in the belly, outside the hand's box."""
    body = of_a_fist(avatar, "hands_on_hips").body
    noise = torch.Generator().manual_seed(5)
    hand = body.skin.vertices[body.skin.weight == 1]
    position = torch.as_tensor(hand)[torch.randint(len(hand), (20000,), generator=noise)]
    position = (position + 0.02 * torch.randn(position.shape, generator=noise, dtype=torch.float64)).float()
    replaced = torch.as_tensor(body.skin.query(position.double().numpy()).weight == 1)
    cloth = torch.zeros(len(position), dtype=torch.bool)
    for _, limbs in body.touched:
        cloth |= limbs.others(position, body.field.pairs(body.frame, position)) < 0
    assert (replaced & cloth).sum() > 500
    assert (body.sdf(position[replaced & cloth], Counters()) < 0).float().mean() > 0.99
    alone = replace(body, contact=None)
    assert not alone.touched
    assert (alone.sdf(position[replaced & cloth], Counters()) >= 0.02).all()


def of_a_fist(avatar: Avatar, pose: str) -> ComposedField:
    """Of a named body pose with clenched hands."""
    fist = {f"{side}_hand_pose": named_hand("fist", side) for side in ("left", "right")}
    signals = Signals.rest().replace(body_pose=named_pose(pose), **fist)
    posed = pose_person(avatar.person, signals, Counters(), None)
    volume = build_volume(avatar, posed, SETTINGS, Counters(), None)
    return composed_field(avatar, posed, volume.body, volume.states, Counters())


def from_part(part: PlacedPart, local: torch.Tensor) -> torch.Tensor:
    """Part-frame points in the root frame, single precision."""
    matrix = torch.as_tensor(part.part_from_root)
    return ((local - matrix[:3, 3]) @ matrix[:3, :3]).float()


def test_single_precision_is_enough(built: tuple[AvatarVolume, ComposedField], exact: ComposedField) -> None:
    points = near_surface(built)
    apart = (built[1].sdf(points).double() - exact.sdf(points.double())).abs()
    assert apart.quantile(0.99) < 2e-6
    assert apart.median() < 2e-7


def test_what_is_clear_is_outside(exact: ComposedField) -> None:
    noise = torch.Generator().manual_seed(2)
    low, high = (torch.as_tensor(corner) for corner in exact.bounds)
    points = low + (high - low) * torch.rand(4000, 3, generator=noise, dtype=torch.float64)
    clear = exact.clearance(points)
    assert 100 < (clear > 0.01).sum() < 4000
    assert (clear == 0).sum() > 10
    step = torch.nn.functional.normalize(torch.randn(4000, 3, generator=noise, dtype=torch.float64), dim=-1)
    away = points + 0.999 * clear[:, None] * step
    assert (exact.sdf(away[clear > 0]) > 0).all()
    assert (exact.sdf(points[clear > 0]) > 0).all()
    assert (exact.sdf(points) < 0).any()


def test_nothing_is_evaluated_where_it_has_no_share(built: tuple[AvatarVolume, ComposedField]) -> None:
    field = replace(built[1], counters=Counters())
    part = next(part for part in field.parts if part.name == "face")
    far = torch.as_tensor(part.part_from_root[:3, :3].T @ (part.high + 0.01 - part.part_from_root[:3, 3])).float()
    field(far[None])
    assert field.counters["face_evaluations"] == 0
    assert field.counters["local_mlp_evaluations"] > 0
    assert np.isfinite(field.sdf(far[None]).numpy()).all()


def test_cloth_beneath_a_hand_maps_to_the_trunk_at_rest(avatar: Avatar) -> None:
    """Where a hand lies on it: the hand's own frames would colour it with flesh that the hand replaces, and nobody saw."""
    posed = pose_person(avatar.person, HIP, Counters(), None)
    aim = tuple(map(float, posed.body.joints[20]))
    seen = render_frame(avatar, HIP, Camera.orbit(60, 10, 0.5, 28, aim, 96, 96)).pointmap
    hand = (avatar.person.hand_weight == 1).numpy()
    beside = cKDTree(posed.body.vertices.numpy()[hand]).query(seen.position.numpy())[0] < 0.03
    cloth = seen.hit & (seen.part_weight.sum(-1) == 0) & torch.from_numpy(beside)
    samples = body_frame(avatar, posed).samples
    assert cloth.sum() > 500
    assert samples is not None
    rest = samples.rest_position(seen.position[cloth])
    nearest = cKDTree(avatar.person.body.v_template.numpy()).query(rest.numpy())[1]
    assert hand[nearest].mean() < 0.01
