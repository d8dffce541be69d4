"""The whole frame: what is skipped, what comes out, and the fallback without OpenGL. Uses the packaged avatar."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.frame import DeferredFrame, Frame
from avatarrex.levels import DEFERRED_LEVELS, level
from avatarrex.ops.native import threads
from avatarrex.pipeline import render_frame
from avatarrex.pointmap.occlusion_edges import OcclusionEdges
from avatarrex.pointmap.raycast import available
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.stage.lighting import lit
from avatarrex.stage.stage import Stage

SETTINGS = RenderSettings(raycast="torch", part_voxel=0.01, antialias=False)
FIRST = Signals.rest().replace(body_pose=named_pose("stand"))
SQUAT = Signals.rest().replace(body_pose=named_pose("squat"))
WORK = (
    "voxels_evaluated",
    "local_mlp_evaluations",
    "hand_distances",
    "face_evaluations",
    "patches_decoded",
    "unet_runs",
)


def camera(azimuth: float = 15.0) -> Camera:
    return Camera.orbit(azimuth, 5, 2.8, 40, (0, -0.05, 0), 48, 48)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar("default")


@pytest.fixture(scope="module")
def first(avatar: Avatar) -> Frame:
    return render_frame(avatar, FIRST, camera(), SETTINGS)


def work(frame: Frame) -> set[str]:
    return {name for name, count in frame.counters.items() if count}


def test_torchs_threads_rest_while_a_frame_is_made(avatar: Avatar) -> None:
    before, seen = torch.get_num_threads(), []
    torch.set_num_threads(2)
    try:
        render_frame(avatar, FIRST, camera(), SETTINGS, None, lambda: seen.append((torch.get_num_threads(), threads())))
        assert set(seen) == {(1, 2)}
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_a_person_is_there(first: Frame) -> None:
    image = first.image
    assert torch.isfinite(image).all()
    coverage = image[..., 3].mean()
    assert 0.05 < coverage < 0.25
    assert first.pointmap.hit[20:28, 22:26].all()
    assert image[..., :3][first.pointmap.hit].std() > 0.05
    assert set(WORK) <= work(first)


def test_nothing_changed_runs_nothing(avatar: Avatar, first: Frame) -> None:
    again = render_frame(avatar, FIRST, camera(), SETTINGS, first)
    assert work(again) == set()
    assert again.image is first.image


def test_camera_only_casts_and_shades(avatar: Avatar, first: Frame) -> None:
    frame = render_frame(avatar, FIRST, camera(60), SETTINGS, first)
    assert not work(frame) & set(WORK) - {"local_mlp_evaluations", "patches_decoded"}
    assert frame.counters["local_mlp_evaluations"] > 0
    assert frame.counters["rays"] > 0
    assert frame.volume is first.volume


def test_patches_are_decoded_once_for_the_nodes_in_sight(avatar: Avatar, first: Frame) -> None:
    nodes, seen = avatar.body.widths.nodes, first.counters["patches_decoded"]
    assert 0 < seen < nodes
    counts = [seen]
    frame = first
    for azimuth in (100, 190, 280):
        frame = render_frame(avatar, FIRST, camera(azimuth), SETTINGS, frame)
        counts.append(frame.counters["patches_decoded"])
    assert sum(counts) <= nodes
    assert counts[3] < counts[0]
    back = render_frame(avatar, FIRST, camera(), SETTINGS, frame)
    assert back.counters["patches_decoded"] == 0
    assert torch.equal(back.image, first.image)


def test_root_motion_leaves_the_volume(avatar: Avatar, first: Frame) -> None:
    moved = FIRST.replace(global_orient=np.array([0, 1.0, 0]), translation=np.array([0.1, 0, 0]))
    frame = render_frame(avatar, moved, camera(), SETTINGS, first)
    assert frame.volume is first.volume
    assert frame.counters["voxels_evaluated"] == 0


def test_expression_touches_the_face_alone(avatar: Avatar, first: Frame) -> None:
    frame = render_frame(avatar, FIRST.replace(expression=named_expression("jaw_open")), camera(), SETTINGS, first)
    assert frame.counters["face_evaluations"] > 0
    assert frame.counters["unet_runs"] in (3, 6)
    assert (
        frame.counters["voxels_evaluated"] == frame.counters["hand_distances"] == frame.counters["patches_decoded"] == 0
    )
    assert frame.volume.grid is first.volume.grid


def test_one_hand_touches_its_own_box(avatar: Avatar, first: Frame) -> None:
    frame = render_frame(avatar, FIRST.replace(left_hand_pose=named_hand("fist", "left")), camera(), SETTINGS, first)
    assert frame.counters["hand_distances"] > 0
    assert frame.volume.parts["right_hand"] is first.volume.parts["right_hand"]
    assert frame.volume.parts["face"] is first.volume.parts["face"]
    assert frame.volume.grid is first.volume.grid
    assert frame.counters["face_evaluations"] == frame.counters["unet_runs"] == frame.counters["patches_decoded"] == 0


def test_body_drag_only_moves_the_boxes(avatar: Avatar, first: Frame) -> None:
    frame = render_frame(avatar, FIRST.replace(body_pose=named_pose("wave")), camera(), SETTINGS, first)
    assert frame.counters["voxels_evaluated"] > 0
    assert frame.counters["hand_distances"] == frame.counters["face_evaluations"] == 0
    assert all(frame.volume.parts[name] is first.volume.parts[name] for name in first.volume.parts)


def test_hidden_parts_cost_nothing(avatar: Avatar) -> None:
    hidden = RenderSettings(raycast="torch", antialias=False, hidden=frozenset({"left_hand", "right_hand", "face"}))
    frame = render_frame(avatar, FIRST, camera(), hidden)
    assert frame.counters["hand_distances"] == frame.counters["face_evaluations"] == frame.counters["unet_runs"] == 0


def test_far_from_the_origin_is_the_same_image(avatar: Avatar, first: Frame) -> None:
    far = np.array([700.0, 0, 700.0])
    moved = Camera.orbit(15, 5, 2.8, 40, far + np.array([0, -0.05, 0]), 48, 48)
    frame = render_frame(avatar, FIRST.replace(translation=far), moved, SETTINGS)
    both = frame.pointmap.hit & first.pointmap.hit
    assert (frame.pointmap.hit != first.pointmap.hit).sum() <= 1
    assert (frame.pointmap.depth - first.pointmap.depth)[both].abs().max() < 1e-3 * SETTINGS.voxel


def test_one_frame_is_the_same_bits_twice(avatar: Avatar, first: Frame) -> None:
    again = render_frame(avatar, FIRST, camera(), SETTINGS)
    assert torch.equal(again.image, first.image)


def test_detail_of_another_pose_changes_colours_alone(avatar: Avatar, first: Frame) -> None:
    settings = replace(SETTINGS, detail_from=FIRST)
    own = render_frame(avatar, FIRST, camera(), settings, first)
    torch.testing.assert_close(own.image, first.image, rtol=0, atol=1e-6)
    other = render_frame(avatar, FIRST, camera(), replace(SETTINGS, detail_from=SQUAT), first)
    assert other.volume is first.volume
    assert 0 < other.counters["patches_decoded"] < avatar.body.widths.nodes
    assert torch.equal(other.image[..., 3], first.image[..., 3])
    assert (other.image - first.image).abs().max() > 0.005


def test_bricks_are_made_where_seen_and_kept_while_the_pose_holds(avatar: Avatar, first: Frame) -> None:
    settings = replace(SETTINGS, bricks=2)
    one = render_frame(avatar, FIRST, camera(), settings, first)
    assert one.volume.grid is first.volume.grid
    assert one.counters["voxels_evaluated"] > 0
    assert one.counters["hand_distances"] == one.counters["face_evaluations"] == one.counters["patches_decoded"] == 0
    assert work(render_frame(avatar, FIRST, camera(), settings, one)) == set()
    turned = render_frame(avatar, FIRST, camera(30), settings, one)
    before, after = (frame.volume.sdf.body.bricks for frame in (one, turned))
    assert before
    assert after
    assert 0 < turned.counters["voxels_evaluated"] < 0.7 * one.counters["voxels_evaluated"]
    assert np.array_equal(after.cell[: len(before.cell)], before.cell)
    back = render_frame(avatar, FIRST, camera(), settings, turned)
    assert back.counters["voxels_evaluated"] == 0
    fist = FIRST.replace(left_hand_pose=named_hand("fist", "left"))
    assert render_frame(avatar, fist, camera(), settings, back).volume.sdf.body.bricks is not None
    plain = render_frame(avatar, FIRST, camera(), SETTINGS, back)
    assert plain.volume.sdf.body is plain.volume.stored
    assert 0 < plain.counters["voxels_evaluated"] < 0.5 * one.counters["voxels_evaluated"]  # those of forearms
    assert torch.equal(plain.image, first.image)


def test_every_level_draws_the_same_person(avatar: Avatar) -> None:
    frames = {
        name: render_frame(avatar, FIRST, camera(), replace(level(name), raycast="torch")) for name in DEFERRED_LEVELS
    }
    masks = [frame.pointmap.hit for frame in frames.values()]
    common = torch.stack(masks).all(0)
    assert common.sum() > 0.97 * torch.stack(masks).any(0).sum()
    depth = torch.stack([frame.pointmap.depth for frame in frames.values()])[:, common]
    assert (depth - depth[0]).abs().median() < 2e-3
    voxels = {name: frame.counters["voxels_evaluated"] for name, frame in frames.items()}
    assert voxels["paper"] > 3 * voxels["balanced"]
    assert voxels["quality"] > voxels["fine"] > voxels["balanced"] > voxels["fast"]


def test_an_unknown_level_is_named() -> None:
    with pytest.raises(InputError, match=r"paper or fast or balanced or fine or quality.*best"):
        level("best")


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
@pytest.mark.parametrize(
    "changes", [{"expression": named_expression("jaw_open")}, {"left_hand_pose": named_hand("fist", "left")}]
)
def test_rays_that_meet_no_changed_box_keep_their_hits(avatar: Avatar, changes: dict[str, np.ndarray]) -> None:
    settings, view = replace(SETTINGS, raycast="gl", antialias=True), camera().resized(96, 96)
    first = render_frame(avatar, FIRST, view, settings)
    frame = render_frame(avatar, FIRST.replace(**changes), view, settings, first)
    alone = render_frame(avatar, FIRST.replace(**changes), view, settings)
    for name in ("position", "normal", "depth", "hit", "coverage", "part_weight", "steps"):
        assert torch.equal(getattr(frame.pointmap, name), getattr(alone.pointmap, name)), name
    assert 0 < frame.counters["rays"] < 0.5 * alone.counters["rays"]
    assert frame.counters["ray_steps"] < 0.5 * alone.counters["ray_steps"]
    turned = render_frame(avatar, FIRST.replace(**changes), camera(60).resized(96, 96), settings, frame)
    assert turned.counters["rays"] >= 96 * 96


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
def test_occlusion_edges_are_antialiased(avatar: Avatar) -> None:
    """Where an arm passes before the chest both are seen, as in a picture of four times the resolution."""
    settings = replace(SETTINGS, raycast="gl", antialias=True)
    signals = Signals.rest().replace(body_pose=named_pose("crossed_arms"))
    view = Camera.orbit(15, 5, 1.2, 40, (0, 0.25, 0), 64, 64)
    frame = render_frame(avatar, signals, view, settings)
    fine = render_frame(avatar, signals, view.resized(256, 256), replace(settings, antialias=False)).image
    wanted = torch.nn.functional.avg_pool2d(fine.permute(2, 0, 1)[None], 4)[0].permute(1, 2, 0)
    mixed = torch.zeros_like(frame.pointmap.hit).flatten()
    mixed[frame.pointmap.edges.pixel] = True
    off, unmixed = (
        (image - wanted).flatten(0, 1)[mixed].square().mean() for image in (frame.image, frame.shading.unmixed)
    )
    assert int(mixed.sum()) > 30
    assert off < 0.8 * unmixed  # what is left are stripes narrower than a pixel
    assert torch.equal(frame.image.flatten(0, 1)[~mixed], frame.shading.unmixed.flatten(0, 1)[~mixed])


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
def test_edges_that_stay_are_mixed_once(avatar: Avatar) -> None:
    settings, view = replace(SETTINGS, raycast="gl", antialias=True), Camera.orbit(15, 5, 1.2, 40, (0, 0.25, 0), 64, 64)
    signals = Signals.rest().replace(body_pose=named_pose("crossed_arms"))
    first = render_frame(avatar, signals, view, settings)
    smiling = signals.replace(expression=named_expression("jaw_open"))
    frame = render_frame(avatar, smiling, view, settings, first)
    alone = render_frame(avatar, smiling, view, settings)
    assert frame.counters["pixels_shaded"] < alone.counters["pixels_shaded"]
    torch.testing.assert_close(frame.image, alone.image, atol=1e-6, rtol=0)


@pytest.mark.skipif("gl" not in available(), reason="no OpenGL 4.3 here")
def test_sheets_are_lit_before_they_are_mixed(avatar: Avatar) -> None:
    """An arm throws its shadow onto the chest: the chest's share of a pixel at the arm's rim is dark."""
    settings, view = replace(SETTINGS, raycast="gl", antialias=True), Camera.orbit(15, 5, 1.2, 40, (0, 0.25, 0), 64, 64)
    signals = Signals.rest().replace(body_pose=named_pose("crossed_arms"))
    frame = render_frame(avatar, signals, view, settings)
    assert isinstance(frame, DeferredFrame)
    light, edges = Stage(shown=True).light, frame.pointmap.edges
    assert light
    bare = replace(frame, surface=replace(frame.surface, pointmap=replace(frame.pointmap, edges=OcclusionEdges.none())))
    (image,), (unmixed,) = (lit([one], light)[0] for one in (frame, bare))
    torch.testing.assert_close(image, edges.blended(unmixed), atol=1e-6, rtol=0)
    gain = unmixed[..., :3].sum(-1) / frame.shading.unmixed[..., :3].sum(-1)
    apart = (gain.flatten()[edges.pixel] - gain.flatten()[edges.beside]).abs()
    assert apart.max() > 0.2
